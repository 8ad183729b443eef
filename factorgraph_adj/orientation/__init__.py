"""Poses and points from image points alone; the choice of the start of every adjustment."""
