"""Formulas: units, kinks, operations, domains, and formulas as a person reads them."""
