"""Scatter of estimates of every kind against covariances: ``python -m tests.benchmarks.scatter``.

Measures and adjusts each network of `tests.support.scatter` so often that a variance that is wrong
by a third shows, prints how often, and raises an AssertionError at the first network that scatters
otherwise. It takes about six CPU minutes.
"""

from __future__ import annotations

from tests.support.scatter import (
    DISTINCT,
    assert_estimates_scatter_as_their_covariance_says,
    assert_the_variance_of_unit_weight_follows_its_distribution,
    many,
)


def main() -> None:
    """Print a line for each network."""
    for name in DISTINCT:
        found = many(name)
        assert_estimates_scatter_as_their_covariance_says(found)
        assert_the_variance_of_unit_weight_follows_its_distribution(found)
        print(f"{name}: {len(found.vtpv)} repetitions scatter as the covariance says", flush=True)


if __name__ == "__main__":
    main()
