"""Approximate values where none are given."""

from .rounds import approximate, reach

__all__ = ["approximate", "reach"]
