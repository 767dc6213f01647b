"""Report model, independent of any format: the measured run, grey references, a table of cells."""
