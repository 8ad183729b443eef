"""Orientation of blocks of photos from image points alone."""
