"""Results and their quality."""
