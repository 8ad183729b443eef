"""Tests of `factorgraph_adj.network`."""
