"""Tests of `factorgraph_adj.papers`."""
