"""Formats of photogrammetric programs and of structure from motion."""
