"""Simulated networks: their specs and parts, drawn errors of readings, values a plan takes."""
