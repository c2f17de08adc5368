"""One program for every event sequence: legs of a motion, elements, rows, and Ipopt."""
