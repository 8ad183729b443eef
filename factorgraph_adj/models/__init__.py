"""Observation models: the only place where each formula stands; numpy only."""
