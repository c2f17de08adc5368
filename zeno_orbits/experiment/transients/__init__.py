"""Transients of a machine: parameters, initial values and event times by single shooting."""
