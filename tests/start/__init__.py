"""Tests of `factorgraph_adj.start.approximate_values`."""
