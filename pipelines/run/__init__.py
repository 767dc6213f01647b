"""One run under a protocol: preparation, rendering, scoring and the report."""
