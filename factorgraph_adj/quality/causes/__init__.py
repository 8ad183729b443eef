"""Causes of misfits: hypotheses of one or a few columns, tested like observations."""
