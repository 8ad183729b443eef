"""Tests of `factorgraph_adj.models`."""
