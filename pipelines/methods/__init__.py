"""Registry of methods: everything that can be asked to render, by its name."""
