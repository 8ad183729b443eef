"""Combined adjustment of terrestrial and photogrammetric observations in one factor graph."""
