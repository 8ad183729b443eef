"""Tests of `factorgraph_adj.report.html`."""
