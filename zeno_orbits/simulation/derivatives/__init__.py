"""Derivatives of an execution and its events with respect to its start and parameters."""
