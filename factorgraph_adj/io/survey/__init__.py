"""Readers and writers of files of programs for survey networks."""
