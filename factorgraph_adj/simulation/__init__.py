"""Simulated networks: measure a plan with random errors, and blocks that do."""
