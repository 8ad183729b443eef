"""Adjustment of whole networks: iteration, datum, elimination, minima and the solution."""
