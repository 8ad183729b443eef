"""Tests of `factorgraph_adj.graph`."""
