"""What would it score if: rendered frames scored again with each fault of their handling undone."""
