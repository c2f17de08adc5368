"""Recordings: named signals over time, their files and tables, and how they repeat."""
