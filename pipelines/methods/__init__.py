"""What can be asked to render: every method by its name."""
