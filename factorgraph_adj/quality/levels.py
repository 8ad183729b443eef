"""The probabilities of tests and regions: one meaning and one default for each, everywhere.

A test, also a significance test, takes ``alpha``, the probability that it rejects a true null
hypothesis. A region or an interval takes ``confidence``, the probability that it covers the truth.
"""

ALPHA = 0.001
"""Probability α0 of a false alarm of the test of one observation, as in Baarda's data snooping."""
ALPHA_OF_MODEL = 0.05
"""Probability of a false alarm of one test of the model: the global test, a test of a parameter."""
POWER = 0.80
"""Probability 1 − β0 with which a gross error of the smallest detectable size is found."""
CONFIDENCE = 0.95
"""Probability with which an error ellipse or an interval covers the truth."""
