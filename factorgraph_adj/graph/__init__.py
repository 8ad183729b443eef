"""A network as unknowns, blocks of observations and weights; its keys and factors in GTSAM."""
