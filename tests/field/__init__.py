"""Tests of `factorgraph_adj.field`."""
