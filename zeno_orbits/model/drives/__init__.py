"""Drives: circuits, motors, waveforms and further states that act on a mechanism."""
