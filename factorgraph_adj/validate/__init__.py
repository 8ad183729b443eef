"""Checks of a network before the adjustment."""
