"""Tests of `factorgraph_adj.simulation`."""
