"""Tests of what a comparison of two epochs says."""
