"""Drives: circuits, motors and further states that act on a mechanism."""
