"""Tests of the published blocks and papers of `examples`."""
