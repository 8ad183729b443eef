"""Components of variance of simulated blocks: ``python -m tests.benchmarks.components``.

With SEEDS and FIRST: as many blocks, from a seed on (500 from 0, about 2 CPU seconds each). Each
seed makes an industry block (4 photos, tape, level) whose tape and level claim a wrong σ. f is the
factor that was found, relative to the true one. For each kind of observation the command prints,
over the seeds,

- the mean of f², which is 1 if the components are unbiased,
- the mean of z = (f − 1)/σ_f, and what it is if f² is χ²_ν/ν: with σ_f = f/√(2ν) this is
  √(2ν)·(1 − E 1/f) ≈ −¾·√(2/ν) = −1.06/√ν,
- the mean of Wilson & Hilferty's (1931) statistic (f^⅔ − 1 + 2/9ν)/√(2/9ν), which is nearly
  normal with mean 0.

What stands after ± is the standard deviation of a mean.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from factorgraph_adj.quality.variance_components import (
    VarianceComponent,
    estimate_variance_components,
)
from factorgraph_adj.types import Array
from tests.networks.wrong_weights import TRUE, industry_block, measured_kinds

SEEDS = 500


def components(seed: int) -> list[VarianceComponent]:
    """Return the components of one block, in the order of `TRUE`."""
    found = estimate_variance_components(industry_block(seed), groups=measured_kinds)
    return [found[kind] for kind in TRUE]


def mean(values: Array) -> str:
    """Return a mean with its standard deviation."""
    return f"{values.mean():6.3f} ± {values.std(ddof=1) / np.sqrt(len(values)):.3f}"


def row(kind: str, found: Sequence[VarianceComponent]) -> str:
    """Return the line of a kind."""
    f = np.array([c.factor for c in found]) / TRUE[kind]
    sigma = np.array([c.sigma for c in found]) / TRUE[kind]
    freedom = np.array([c.freedom for c in found])
    nu = float(freedom.mean())
    expected = -0.75 * np.sqrt(2.0 / nu)
    ninth = 2.0 / (9.0 * freedom)
    hilferty = (f ** (2 / 3) - (1.0 - ninth)) / np.sqrt(ninth)
    return (
        f"{kind:18} {nu:6.1f}   {mean(f**2)}   {mean((f - 1.0) / sigma)} ({expected:5.2f})"
        f"   {mean(hilferty)}"
    )


def main() -> None:
    """Print a line for each kind."""
    given = [int(a) for a in sys.argv[1:]]
    number, first = given + [SEEDS, 0][len(given) :]
    blocks = [components(seed) for seed in range(first, first + number)]
    print(f"{'kind':18} {'ν':>6}   {'f²':14}   {'z (expected)':22}   Wilson–Hilferty")
    for kind, found in zip(TRUE, zip(*blocks, strict=True), strict=True):
        print(row(kind, found))


if __name__ == "__main__":
    main()
