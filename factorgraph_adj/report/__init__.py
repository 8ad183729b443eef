"""Protocols, tables and figures of an adjustment."""
