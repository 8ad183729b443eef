"""Experiments: a trial repeated under chosen conditions, its results and their summary."""
