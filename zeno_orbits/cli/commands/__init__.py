"""The commands. Each module contains one command, or several commands with the same input."""
