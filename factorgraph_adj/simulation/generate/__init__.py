"""Generators: parts of a simulated network, each with its parameters and what it adds."""
