"""Tests of `factorgraph_adj.experiment`."""
