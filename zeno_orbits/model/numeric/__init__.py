"""model.numeric."""
