"""Tests of `factorgraph_adj.validate`."""
