"""Comparison of an orbit with a recording: alignment, contacts, deviations, metrics with errors."""
