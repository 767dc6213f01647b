"""Tables: the standard tables, the paper's cells, comparisons of runs, and their file formats."""
