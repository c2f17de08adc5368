"""experiment.comparison."""
