"""Inputs damaged at random: refused by name, or adjusted rightly, never with a traceback."""
