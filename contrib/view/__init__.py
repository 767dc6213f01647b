"""A live view in the browser: the camera is dragged, and the online method renders its view."""
