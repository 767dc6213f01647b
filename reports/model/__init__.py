"""What a report is about, before it has a format: the measured run, grey references, a table of cells."""
