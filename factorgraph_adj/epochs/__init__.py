"""Two epochs of an object: what moved, and how far."""
