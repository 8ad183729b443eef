"""Strips and blocks from units: relative orientations, independent models, strips, directions."""
