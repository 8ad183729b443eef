"""The factor graph of a network for GTSAM, with its optimisers, and iSAM2 on it."""
