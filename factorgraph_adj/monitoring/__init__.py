"""Epoch after epoch of one object: what moves, how fast, and when to raise an alarm."""
