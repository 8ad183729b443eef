"""Readers and writers of field books, and of files of programs for survey networks."""
