"""Executions by the compiled loop, and single flows."""
