"""Reference systems: grid coordinates and heights become coordinates of a frame, and back."""
