"""Registry of rendering methods, by name."""
