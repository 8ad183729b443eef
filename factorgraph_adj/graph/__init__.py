"""From a network to variables, blocks of observations, and a GTSAM factor graph."""
