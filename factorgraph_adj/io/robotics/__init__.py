"""Readers of robotics: pose graphs, trajectories, calibrations of cameras on a body."""
