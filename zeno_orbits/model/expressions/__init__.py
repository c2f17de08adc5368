"""Formulas: their operations, their kinks, and the units of their values."""
