"""Least-squares collocation: signals with a covariance function, filtered and predicted."""
