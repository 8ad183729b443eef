"""Experiments: a trial repeated under chosen conditions, its results and its summary."""
