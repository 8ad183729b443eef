"""Generators of the parts of a simulated network, each with its parameters."""
