"""Points without observed heights: the message names the plane network; others do not."""

from __future__ import annotations

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.validate.network_structure import check

ADVICE = "make the network plane where heights are not wanted (dimension = 2)"


def network_with(*observations: fga.Observation) -> fga.Network:
    """Return a small network, of which P has these observations alone."""
    network = fga.Network("heights are missing")
    for name, xyz in {"A": (0, 0, 0), "B": (90, 0, 1), "C": (40, 80, 2), "D": (9, 50, 3)}.items():
        network.add_point(name, xyz, fixed="" if name == "D" else "xyz")
    network.add_point("P", (50.0, 30.0, 1.0))
    for name in "ABC":
        network.add(fga.SlopeDistance(name, "D", 50.0, sigma=1.0))
    network.add(*observations)
    return network


@pytest.mark.parametrize(
    ("observations", "advised"),
    [
        ([fga.HorizontalDistance(n, "P", 50.0, sigma=1.0) for n in "AB"], True),
        ([fga.Azimuth(n, "P", 1.0, sigma=1.0) for n in "AB"], True),
        ([fga.SlopeDistance(n, "P", 50.0, sigma=1.0) for n in "AB"], False),
        ([fga.Azimuth("A", "P", 1.0, sigma=1.0), fga.ZenithAngle("A", "P", 1.5, sigma=1.0)], False),
    ],
)
def test_points_that_only_plan_observations_have_are_advised_to_be_plane(observations, advised):
    network = network_with(*observations)
    (said,) = [str(p) for p in check(network) if "'P'" in str(p)]
    assert "for 3 free coordinates" in said
    assert (ADVICE in said) == advised


def test_where_leaving_out_is_in_vain_the_error_of_the_adjustment_is_told(tmp_path, capsys):
    """No height of the part that plan reaches is observed: leaving out does not help."""
    network = fga.Network("held in plan", datum="given")
    for name, xyz in {"A": (0, 0, 0), "B": (90, 0, 1), "C": (40, 80, 2)}.items():
        network.add_point(name, xyz, fixed="x")
    network.add_point("P")
    network.add(fga.ZenithAngle("A", "P", 1.5, sigma=1e-5))
    for a, b in ("AB", "BC", "CA"):
        network.add(fga.HorizontalDistance(a, b, 90.0, sigma=1.0))
    fga.write_project(network, tmp_path / "p" / "project.toml")
    for option in ((), ("--leave-out-undetermined",)):
        assert main(["adjust", str(tmp_path / "p"), *option]) == 2
    told = capsys.readouterr().err
    alone, in_vain = told.split("problem", 1)[1], told.rsplit("problem", 1)[1]
    assert "only 1 zenith angle for 3 free coordinates" in alone
    assert "for 3 free coordinates" not in in_vain
