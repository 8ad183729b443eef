"""A mistake in one epoch, of which its own readings tell, is no displacement."""

from __future__ import annotations

from typing import Any

import pytest

import factorgraph_adj as fga
from factorgraph_adj.report.epochs_report import render_congruence
from tests.networks.mistaken import yard

MISTAKES: tuple[tuple[dict[str, Any], str], ...] = (
    ({"height": 0.02}, "the height of the instrument at 'S1' (1.62 m)"),
    ({"constant": 0.0175}, "the zero constant (prism constant) of distances everywhere"),
)


def compared(first: fga.Network, second: fga.Network, **options: Any) -> fga.Congruence:
    """Compare two epochs."""
    return fga.congruence(fga.adjust(first), fga.adjust(second), **options)


@pytest.mark.parametrize(("mistake", "named"), MISTAKES)
def test_the_cause_in_one_epoch_is_said_before_what_moved(
    mistake: dict[str, Any], named: str
) -> None:
    for seed in range(3):
        found = compared(yard(2 * seed), yard(2 * seed + 1, **mistake))
        (said,) = (s for s in found.alternatives if "the second epoch alone" in s)
        assert named in said
        assert not found.fine
        first_line = " ".join(render_congruence(found).split("\n\n")[0].split())
        assert said in first_line


def test_the_cause_in_the_first_epoch_is_said_of_it() -> None:
    found = compared(yard(1, height=-0.03), yard(2), variance="a-priori")
    (said,) = found.alternatives
    assert said.startswith("in the first epoch alone, an error of")
    assert said.endswith(
        "in which of: the height of the instrument at 'S1' (1.57 m); the height of the target at "
        "'S1' (1.5 m); put it right before any displacement is believed"
    )


def test_an_epoch_that_exchanged_names_keep_from_a_minimum_is_refused_with_them() -> None:
    """Its normal equations are singular where the iteration ended."""
    with pytest.raises(fga.AdjustmentError) as refused:
        compared(yard(1), yard(2, exchanged=True))
    said = str(refused.value)
    assert "the second epoch is not converged" in said
    assert "two targets, exchanged: 'K2' and 'P0' seen from 'S1'" in said


@pytest.mark.parametrize("variance", ["pooled", "a-priori"])
def test_displacements_without_a_mistake_are_not_doubted(variance: str) -> None:
    for seed in range(3):
        found = compared(yard(2 * seed), yard(2 * seed + 1, shift=0.02), variance=variance)
        assert found.alternatives == ()
        assert "P1" in found.roles.reference or "P1" in found.moved
