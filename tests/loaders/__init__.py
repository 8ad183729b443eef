"""Readers of the formats that real measurements come in; only tests need them."""
