"""experiment.identification."""
