"""Readers and writers of photogrammetric programs."""
