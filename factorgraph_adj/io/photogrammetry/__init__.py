"""Readers and writers of formats of photogrammetric programs and of structure from motion."""
