"""Parts of a problem that a user declares: its file, quantities, starts, drawing and rig."""
