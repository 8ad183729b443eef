"""Tests of `factorgraph_adj.planning`."""
