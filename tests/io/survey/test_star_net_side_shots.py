"""Side shots of STAR*NET bear on nothing, and reverse readings are those of the other face."""

from __future__ import annotations

import json

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.report.text import text_report
from factorgraph_adj.units import ARCSEC

SETTINGS = {
    "adjustment": "3D",
    "linear": "Meters",
    "angular": "DMS",
    "order": "EN",
    "stations": "AtFromTo",
    "distances": "Slope",
    "distance": 0.002,
    "distance_ppm": 2,
    "angle": 2,
    "direction": 2.8,
    "zenith": 2.8,
    "centring_instrument": 0.001,
    "centring_target": 0.001,
    "centring_vertical": 0.001,
    "refraction": 0.07,
}
NETWORK = """
C A 0 0 100 ! ! !
C B 200 20 104 ! ! !
DB S1
DM A 243-41-24.2 108.1850 91-03-33.4
DM B 146-33-54.2 156.5375 89-16-04.6
DM S2 107-28-16.3 92.2009 89-22-42.8
DE
DB S2
DM A 263-44-46.2 186.0349 90-55-26.4
DM B 180-56-43.4 102.9612 89-26-36.6
DM S1 287-28-16.3 92.2009 90-37-17.2
DE
"""
SIDE_SHOTS = """
SS S1-A-X 170-16-20.7 102.3914 74-07-47.0
SS S2-B-X 173-31-00.9 90.2816 72-19-56.5
SS S1-S2-B 39-05-37.9 156.9 89-16-04.6
"""
"""X twice, 0.4 m apart in height, and a shot to the held point B that is 0.36 m too long."""


def adjusted(tmp_path, text):
    path = tmp_path / "job.dat"
    path.write_text(text)
    return fga.adjust(fga.read(path, options=SETTINGS))


def test_side_shots_change_nothing(tmp_path):
    without = adjusted(tmp_path, NETWORK)
    found = adjusted(tmp_path, NETWORK + SIDE_SHOTS)
    assert found.redundancy == without.redundancy
    assert found.vtpv == pytest.approx(without.vtpv, rel=1e-6, abs=1e-9)
    for name in ("A", "B", "S1", "S2"):
        assert found.point(name) == pytest.approx(without.point(name), abs=1e-8)
        assert found.standard_deviations(name) == pytest.approx(
            without.standard_deviations(name), rel=1e-6, abs=1e-12
        )
    assert found.point("X") == pytest.approx([100, 180, 130.0], abs=1e-3)
    assert found.point("X.2") == pytest.approx([100, 180, 130.4], abs=1e-3)
    named = [n for n, p in found.network.points.items() if p.side_shot]
    assert named == ["X", "X.2", "B.2"]


def test_a_side_shot_has_the_sigma_that_follows_from_station_backsight_and_readings(tmp_path):
    """Numerical law of propagation, with the covariance of S1 and A of the network without it."""
    without = adjusted(tmp_path, NETWORK)
    found = adjusted(tmp_path, NETWORK + SIDE_SHOTS)
    shot = [o for o in found.network.observations.values() if "X" in o.points()]
    kinds = {o.kind: o for o in shot}
    angle, far, zenith = (kinds[k] for k in ("horizontal_angle", "slope_distance", "zenith_angle"))

    def place(at, back, t, s, z):
        azimuth = np.arctan2(*(back - at)[:2]) + t
        level = s * np.sin(z)
        up = s * np.cos(z) - (2 * 0.07 - 1) * level**2 / (2 * 6.38e6)
        return at + np.array([level * np.sin(azimuth), level * np.cos(azimuth), up])

    values = [without.point("S1"), without.point("A"), angle.value, far.value, zenith.value]
    assert found.point("X") == pytest.approx(place(*values), abs=2e-4)
    stations = np.array([0.0, 0.0, 0.0])
    columns = []
    for i in range(3):
        stations[:] = 0
        stations[i] = 1e-4
        columns.append((place(values[0] + stations, *values[1:]) - place(*values)) / 1e-4)
    j = np.array(columns).T
    cov = j @ without.covariance("S1") @ j.T
    sigmas = found.observations.sigmas
    labels = [found.equations.label(i) for i in range(len(sigmas))]
    for k, o in enumerate((angle, far, zenith)):
        sigma = sigmas[labels.index(o.label())]
        moved = list(values)
        moved[2 + k] = moved[2 + k] + 1e-6
        own = (place(*moved) - place(*values)) / 1e-6
        cov = cov + sigma**2 * np.outer(own, own)
    assert found.standard_deviations("X") == pytest.approx(np.sqrt(np.diag(cov)), rel=2e-3)


def test_results_tell_side_shots_apart(tmp_path):
    found = adjusted(tmp_path, NETWORK + SIDE_SHOTS)
    said = text_report(found)
    heading = said.index("Side shots: computed from the adjusted points; nothing checks them")
    assert "  S2 " in said[said.index("Adjusted coordinates") : heading]
    assert "  X.2 " not in said[said.index("Adjusted coordinates") : heading]
    assert "(2 held, 3 side shots)" in said
    fga.write(found, tmp_path / "results.json")
    points = json.loads((tmp_path / "results.json").read_text())["points"]
    assert [n for n, p in points.items() if p.get("side_shot")] == ["X", "X.2", "B.2"]
    fga.write_project(found.network, tmp_path / "project" / "project.toml")
    again = fga.read_project(tmp_path / "project")
    assert [n for n, p in again.points.items() if p.side_shot] == ["X", "X.2", "B.2"]


@pytest.mark.parametrize("both", [("A", "B"), ("A", "B", "C"), ()])
def test_reverse_directions_of_dm_are_those_of_face_one(tmp_path, both):
    """Readings of targets in ``both`` faces, or each in reverse, give what face 1 gives."""
    points = {"A": (0, 0, 100), "B": (120, 10, 104), "C": (60, 140, 98)}
    at, rows, plain = np.array([50.0, 40.0, 101.0]), [], []
    for n, xyz in points.items():
        d = np.array(xyz, float) - at
        s, level = np.linalg.norm(d), np.hypot(*d[:2])
        z = np.arctan2(level, d[2]) - (2 * 0.07 - 1) * level / (2 * 6.38e6)
        t = (np.arctan2(d[0], d[1]) - 0.3) % (2 * np.pi)
        plain.append((n, t, s, z))
        rows += [(n, t, s, z)] if n in both or not both else []
        rows.append((n, (t + np.pi) % (2 * np.pi), s, 2 * np.pi - z))
    head = "".join(f"C {n} {x} {y} {z} ! ! !\n" for n, (x, y, z) in points.items())

    def text(rows):
        lines = (
            f"DM {n} {t / np.pi * 200:.6f} {s:.5f} {z / np.pi * 200:.6f}" for n, t, s, z in rows
        )
        return ".UNITS GONS\n" + head + "DB S\n" + "\n".join(lines) + "\nDE\n"

    found = adjusted(tmp_path, text(rows))
    assert found.point("S") == pytest.approx(at, abs=1e-4)
    assert found.sigma0 < 0.5
    one = adjusted(tmp_path, text(plain))
    assert found.point("S") == pytest.approx(one.point("S"), abs=2e-5)
    directions = [o for o in found.network.observations.values() if o.kind == "direction"]
    assert {o.target: round(o.value / ARCSEC) for o in directions} == {
        n: round(t / ARCSEC) for n, t, _, _ in plain
    }
