"""An orbit laid over a recording: alignment, contacts, deviations, and numbers with errors."""
