"""Readers and writers of formats, projects, tables, journals; transactions of files."""
