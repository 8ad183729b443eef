"""The network: its points, cameras, photos, other unknowns and observations, and their changes."""
