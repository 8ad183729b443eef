"""Models of observations, lenses, shapes and unknowns: one definition of each formula, in numpy."""
