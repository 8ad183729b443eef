"""Tests of `factorgraph_adj.io`."""
