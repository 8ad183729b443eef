"""Causes of misfits: errors of one or a few columns, tested like observations."""
