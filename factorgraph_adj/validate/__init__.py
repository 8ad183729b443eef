"""Checks of a network and of its readings before the adjustment."""
