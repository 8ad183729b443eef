"""Size and power of the tests of two epochs: ``python -m tests.benchmarks.epochs [--seeds N]``."""

from __future__ import annotations

import argparse

from tests.networks.epochs import detectable_shift, rates


def main() -> None:
    """Print how often the tests reject without and with a displacement."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1000, help="pairs of epochs (1000)")
    n = parser.parse_args().seeds
    size, _ = rates(range(10_000, 10_000 + n), (0.0, 0.0))
    _, power = rates(range(20_000, 20_000 + n), detectable_shift())
    print(f"{n} pairs of epochs in which nothing moved: the shape is rejected in {size:.1%}")
    print(f"{n} displacements of the detectable size: {power:.1%} are found")


if __name__ == "__main__":
    main()
