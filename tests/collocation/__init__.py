"""Tests of `factorgraph_adj.quality`."""
