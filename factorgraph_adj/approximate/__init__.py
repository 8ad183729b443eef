"""Approximate values where none are given."""

from .rounds import approximate

__all__ = ["approximate"]
