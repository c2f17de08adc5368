"""Executions by the compiled loop: single flows, one stop, and graphs of modes."""
