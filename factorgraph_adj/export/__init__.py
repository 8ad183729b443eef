"""Results in the formats of other programs: maps, drawings, point clouds, labelled arrays."""
