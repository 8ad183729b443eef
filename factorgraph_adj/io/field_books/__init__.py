"""Readers of raw files of instruments: field books of total stations and levels."""
