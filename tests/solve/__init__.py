"""Tests of `factorgraph_adj.solve`."""
