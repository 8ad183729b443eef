"""Tests of `factorgraph_adj.service`."""
