"""Checks of the readings themselves, before any adjustment: what does not close is named."""
