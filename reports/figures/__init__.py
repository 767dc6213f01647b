"""Figures as PNG and PDF: curves, slices through space and time, crops, quality over K."""
