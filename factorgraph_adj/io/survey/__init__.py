"""Files of programs for survey networks: Comp3D, LGC2, JAG3D."""
