"""Observation models: the single definition of each formula, in numpy only."""
