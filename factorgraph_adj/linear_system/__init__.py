"""The network as linear equations that grow: in iSAM2, and in fronts."""
