"""Tests of `factorgraph_adj.site`."""
