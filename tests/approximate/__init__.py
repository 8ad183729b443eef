"""Tests of `factorgraph_adj.approximate`."""
