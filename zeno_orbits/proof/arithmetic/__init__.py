"""Ball arithmetic: intervals, Taylor coefficients, polynomials and programs of formulas."""
