"""report.terminal."""
