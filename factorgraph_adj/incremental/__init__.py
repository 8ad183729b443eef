"""Adjustment of observations as they arrive, in one iSAM2."""
