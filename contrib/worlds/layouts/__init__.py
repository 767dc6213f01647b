"""A demo capture written in the layout of each data set."""
