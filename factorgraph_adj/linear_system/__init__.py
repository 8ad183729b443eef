"""Linear equations of an adjusted network that rows join and leave, in iSAM2 or in fronts."""
