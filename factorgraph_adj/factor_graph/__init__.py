"""Networks in GTSAM: the factor graph, tests of factors, and iSAM2 with linear rows."""
