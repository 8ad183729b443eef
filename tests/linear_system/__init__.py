"""Tests of `factorgraph_adj.incremental`."""
