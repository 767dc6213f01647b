"""Reports: tables, slices, curves and the page, read from run folders on disk; nothing is rendered or measured here."""
