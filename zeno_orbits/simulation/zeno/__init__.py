"""The Zeno limit: the end of an impact sequence, extrapolated, followed or truncated."""
