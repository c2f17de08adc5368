"""continuation.two_parameters."""
