"""Approximate values where none are given."""
