"""One run folder of what several machines made."""
