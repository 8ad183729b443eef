"""A σ in a wrong unit is named with its group; gross errors and honest σ are not."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.quality.doubtful_sigmas import doubtful_sigmas
from tests.field_mistakes.projects import Project, yard
from tests.field_mistakes.site import site

LONG = pytest.mark.slow(
    "seeded networks with gross errors or another unit; short tests name the unit of small ones"
)


def told(p: Project, folder) -> list[str]:
    """Return the groups that are doubted, with the size of the mistake."""
    s = fga.adjust(fga.read_project(p.write(folder / "p")))
    if not s.converged:  # the doubt is told already
        return []
    found = doubtful_sigmas(fga.reliability(s))
    return [f"{d.group} {'large' if d.factor < 1 else 'small'}" for d in found]


def stating(old: str, new: str, *, seed: int = 5, make=site) -> Project:
    """Return the site with another statement of σ."""
    p = make(seed)
    assert old in p.toml
    p.toml = p.toml.replace(old, new)
    return p


@LONG
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("old", "new", "group"),
    [
        ("sigma_mm = 2\n", "sigma_m = 2\n", "slope distance large"),
        ("sigma_mgon = 1.2", "sigma_gon = 1.2", "zenith angle large"),
        ("sigma_mgon = 1.2", "sigma_mgon = 0.0012", "zenith angle small"),
        ("sigma_mm = 2\nppm = 2", "sigma_mm = 0.002", "slope distance small"),
    ],
)
def test_a_unit_of_one_group_is_named(old, new, group, seed, tmp_path) -> None:
    assert told(stating(old, new, seed=seed), tmp_path) == [group]


@pytest.mark.parametrize("seed", [4, 6, 8, 9])
def test_a_part_in_another_unit_is_named(seed: int, tmp_path) -> None:
    """0.002 mm + 2 ppm for 2 mm + 2 ppm: 7 times too small over these lengths."""
    p = stating("sigma_mm = 2\n", "sigma_mm = 0.002\n", seed=seed)
    assert told(p, tmp_path) == ["slope distance small"]


def test_what_one_reading_explains_is_not_called_a_wrong_sigma(tmp_path) -> None:
    """The same σ, with other errors: without one distance of 6.5 σ everything fits."""
    assert told(stating("sigma_mm = 2\n", "sigma_mm = 0.002\n", seed=5), tmp_path) == []


def test_several_groups_are_named_together(tmp_path) -> None:
    p = stating("sigma_mgon = 1.2", "sigma_mgon = 0.0012")
    p.toml = p.toml.replace("sigma_mm = 2\n", "sigma_mm = 0.002\n")
    assert sorted(told(p, tmp_path)) == ["slope distance small", "zenith angle small"]


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("make", [site, yard])
def test_right_standard_deviations_are_not_doubted(make, seed, tmp_path) -> None:
    assert told(make(seed), tmp_path) == []


@LONG
@pytest.mark.parametrize("size", [0.02, 1.0, 100.0])
@pytest.mark.parametrize("kind", ["direction", "zenith_angle", "slope_distance"])
def test_gross_errors_are_no_standard_deviations(kind, size, tmp_path) -> None:
    p = site()
    for row in np.random.default_rng(2).choice(np.array(p.rows(kind)), 2, replace=False):
        row["value"] = f"{float(row['value']) + size:.4f}"
    assert told(p, tmp_path) == []


@pytest.mark.parametrize("factor", [0.2, 5.0])
def test_standard_deviations_that_are_careful_or_bold_are_no_mistakes(factor, tmp_path) -> None:
    p = stating("sigma_mgon = 1.2", f"sigma_mgon = {1.2 * factor}")
    assert told(p, tmp_path) == []


LINES = {
    "8 lines, 6 points": [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 0), (0, 2), (3, 5)],
    "7 lines, 5 points": [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (0, 2), (1, 3)],
}
"""Levelled lines of a small redundancy, where one gross error spreads over whole loops."""


def levelled(lines: list[tuple[int, int]], seed: int, gross: float, sigma: float) -> fga.Network:
    """Return levelling beside distances, with an error of one line and a stated σ, metres."""
    rng = np.random.default_rng([seed, 11])
    names = sorted({p for line in lines for p in line})
    z, xy = rng.uniform(0, 10, len(names)), rng.uniform(0, 300, (len(names), 2))
    network = fga.Network("levelled")
    for i in names:
        network.add_point(
            f"P{i}", (*xy[i], z[i]), fixed="xyz" if i == 0 else "xy" if i == 1 else ""
        )
    wrong = int(rng.integers(len(lines)))
    for i, (a, b) in enumerate(lines):
        value = float(z[b] - z[a] + rng.normal(0, 1e-3) + gross * (i == wrong))
        network.add(fga.observations.HeightDifference(f"P{a}", f"P{b}", value, sigma=sigma))
    for a in names:
        for b in names[a + 1 :]:
            length = float(np.hypot(*(xy[a] - xy[b])) + rng.normal(0, 2e-3))
            network.add(fga.observations.HorizontalDistance(f"P{a}", f"P{b}", length, sigma=2e-3))
    return network


@pytest.mark.parametrize("lines", LINES)
@pytest.mark.parametrize("gross", [0.1, 0.3, 1.0])
def test_one_gross_error_in_small_loops_is_no_wrong_sigma(lines: str, gross: float) -> None:
    for seed in range(8):
        solution = fga.adjust(levelled(LINES[lines], seed, gross, 1e-3))
        assert not doubtful_sigmas(fga.reliability(solution))


@pytest.mark.parametrize("lines", LINES)
def test_sigmas_of_small_loops_that_are_too_small_are_named_all_the_same(lines: str) -> None:
    named = 0
    for seed in range(8):
        solution = fga.adjust(levelled(LINES[lines], seed, 0.0, 1e-6))
        named += bool(doubtful_sigmas(fga.reliability(solution)))
    assert named >= 4
