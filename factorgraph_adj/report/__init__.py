"""Protocols and tables for people."""
