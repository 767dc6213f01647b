"""One run under a protocol: what every method needs, their frames, their scores, and the report at the end."""
