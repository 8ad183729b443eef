"""Tests of `factorgraph_adj.observations`."""
