"""Linear systems of whole networks and their solution."""
