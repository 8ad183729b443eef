"""Tests of `factorgraph_adj.start.search`."""
