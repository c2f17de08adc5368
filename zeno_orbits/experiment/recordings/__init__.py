"""experiment.recordings."""
