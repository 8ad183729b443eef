"""Readers and writers of field books and of formats of survey programs."""
