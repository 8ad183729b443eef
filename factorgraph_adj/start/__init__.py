"""Start values of adjustments: approximate values, and photos from image points alone."""
