"""Files of survey programs and field books: GSI, SDR33, STAR*NET, Comp3D, LGC2, JAG3D."""
