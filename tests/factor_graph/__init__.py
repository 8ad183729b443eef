"""Tests of the factor graph for GTSAM."""
