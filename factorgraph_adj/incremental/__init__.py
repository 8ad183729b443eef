"""Adjustment of observations as they arrive: tests, waiting, readmission, retirement, queries."""
