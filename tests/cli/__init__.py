"""Tests of `factorgraph_adj.cli`."""
