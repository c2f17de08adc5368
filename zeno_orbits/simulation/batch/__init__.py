"""Many completed executions at once, in lockstep."""
