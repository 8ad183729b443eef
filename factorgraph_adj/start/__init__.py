"""Start values of adjustments: approximate values of all unknowns, step by step."""
