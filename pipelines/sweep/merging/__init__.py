"""One run folder from the results of several machines."""
