"""What a report says of ties, drifts, attitudes, photos without points, and of rounding."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.attitude import from_omega_phi_kappa, to_omega_phi_kappa
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.quality.reliability import MAX_STIFF_REDUNDANCY, stiff_ties
from factorgraph_adj.report.adjusted_observations import redundancy_text
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import measure
from tests.networks.rigs import rig
from tests.networks.small_flight import Plan, observed, plan_of
from tests.networks.three_frames import three_frames


def lines_of(text: str, heading: str) -> str:
    """Return a section as one line."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(heading))
    end = next(i for i in range(start, len(lines)) if not lines[i])
    return " ".join(" ".join(lines[start:end]).split())


@pytest.fixture(scope="module")
def rigid() -> fga.Solution:
    return fga.adjust(measure(rig(), seed=1))


def test_ties_of_rigid_mounts_are_told_in_one_sentence_and_not_listed(rigid) -> None:
    text = fga.text_report(rigid)
    words = lines_of(text, "Reliability")
    assert "24 stiff ties (relative position, relative rotation; r up to" in words
    assert "stated of the model and not measured" in words
    assert "controlled by no other observation" not in words
    assert "all 226 55.00 0.00 0.24 0.81 –" in words
    assert "relative" not in lines_of(text, "Weakest observations")


def test_a_play_that_shows_an_error_makes_no_stiff_tie() -> None:
    loose = fga.adjust(measure(rig(play=(1e-3, 1e-2)), seed=1))
    rel = fga.reliability(loose)
    assert not stiff_ties(rel).any()
    assert "stiff" not in fga.text_report(loose)


def test_stiff_ties_are_those_that_were_stated(rigid) -> None:
    """A measured relative pose without control is told, however small its redundancy number is."""
    rel = fga.reliability(rigid)
    ties = stiff_ties(rel)
    kinds = np.concatenate(
        [np.full(b.observed.size, b.kind) for b in rigid.equations.blocks if not b.prior]
    )
    assert set(kinds[ties]) == {"relative_rotation", "relative_position"}
    assert ties.sum() == 72
    assert np.abs(rel.redundancy_numbers[ties]).max() < MAX_STIFF_REDUNDANCY
    network = fga.Network("odometry")
    network.add_camera("camera", NoDistortion(), {"c": 10.0})
    network.add_photo("A", "camera", position=(0, 0, 0), rotation=np.eye(3), fixed=True)
    network.add_photo("B", "camera", position=(1, 0, 0), rotation=np.eye(3))
    network.add(
        o.RelativeRotation("A", "B", (0, 0, 0), sigma=(1e-8,) * 3),
        o.RelativePosition("A", "B", (1, 0, 0), sigma=(1e-6,) * 3),
        o.RelativePosition("A", "B", (1, 0, 0), sigma=(1e-6,) * 3),
    )
    assert not stiff_ties(fga.reliability(fga.adjust(network))).any()
    assert "controlled by no other observation" in lines_of(
        fga.text_report(fga.adjust(network)), "Reliability"
    )


def test_a_photo_without_points_has_no_root_mean_square(rigid) -> None:
    text = fga.text_report(rigid)
    assert "nan" not in text
    row = next(line for line in text.splitlines() if line.startswith("  E2 left "))
    assert row.split()[2:4] == ["0", "–"]


def test_drifts_are_per_unit_of_time() -> None:
    parts = ("x", "y", "z", "x_t", "y_t", "z_t")
    text = fga.text_report(fga.adjust(observed(plan_of(Plan(drift=parts)), 1)))
    assert "x [mm]" in text
    assert "x_t [mm/t]" in text
    assert "x_t [mm]" not in text
    assert "t of units: the time or place along a strip, in the unit of observations" in text


def test_components_that_a_power_of_time_multiplies_say_so() -> None:
    for kind in ("drift", "attitude_drift", "profile"):
        for component in fga.models.unknown_registry.UNKNOWNS[kind].components:
            _, _, power = component.name.partition("_")
            assert component.power == len(power), component.name


def test_rounding_below_zero_is_zero() -> None:
    assert redundancy_text(-1e-14) == "0.00"
    assert redundancy_text(-1e-3) == "0.00"


def test_shares_of_what_is_not_determined_lie_between_0_and_1() -> None:
    """A frame without observations leaves six combinations open, and each component alone."""
    network = three_frames()
    zero = dict.fromkeys(("rx", "ry", "rz", "x", "y", "z"), 0.1)
    network.add_frame("loose", values=zero)
    with pytest.raises(fga.DatumError, match=r"weakest component: rx, share 1\.00\)") as caught:
        fga.adjust(network)
    assert caught.value.defect == 6


@pytest.mark.parametrize("navigation", [False, True])
def test_adjusted_attitudes_are_those_of_the_photo_for_large_residuals_too(navigation) -> None:
    """Two attitudes 0.5 rad apart: both adjusted values are the attitude of the photo."""
    network = fga.Network("attitude")
    network.add_camera("camera", NoDistortion(), {"c": 10.0})
    network.add_photo(
        "A", "camera", position=(0, 0, 0), omega_phi_kappa=(0.3, 0.2, 0.1), fixed=[0, 0, 0, 1, 1, 1]
    )
    first = np.array([[0.3, 0.2, 0.1]])
    kind = o.NavigationAttitude if navigation else o.PhotoAttitude
    turned = from_omega_phi_kappa(first) @ exp_rotation(np.array([[0.3, -0.4, 0.1]]))
    for name, value in (("1", first), ("2", to_omega_phi_kappa(turned))):
        network.add(kind("A", tuple(value[0].tolist()), sigma=(0.5,) * 3, id=name))
    solution = fga.adjust(network)
    rows = list(Report(solution).rows.all())
    one, two = (np.array([r.adjusted for r in rows if r.id == i]) for i in "12")
    assert np.abs([r.residual for r in rows]).max() > 0.1
    assert np.mod(one, 2 * np.pi) == pytest.approx(np.mod(two, 2 * np.pi), abs=1e-9)
    plain = np.array([r.observed + r.residual for r in rows])
    assert np.abs(plain[:3] - one).max() > 1e-3
