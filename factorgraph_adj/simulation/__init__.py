"""Simulated networks: measurement of a plan with random errors, and simulated blocks."""
