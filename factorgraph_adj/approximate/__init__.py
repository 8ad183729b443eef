"""Approximate values of unknowns without given values."""

from .rounds import approximate, reach

__all__ = ["approximate", "reach"]
