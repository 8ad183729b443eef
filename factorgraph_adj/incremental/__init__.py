"""Adjustment of observations as they arrive: a batch solution, and what joined or left since."""
