"""A site with two held points and two set-ups, whose new points have no coordinates.

Distances, zenith angles, levelling and GNSS vectors control one another, so that each mistake
contradicts something; without approximate coordinates nothing but readings and held points tells.
"""

from __future__ import annotations

import numpy as np

from .projects import GON, Project, Row

PLACES = {
    "A": (1000.0, 2000.0, 150.0),
    "B": (1150.0, 2040.0, 152.5),
    "S2": (1090.1234, 2110.5678, 149.3912),
    "P1": (1040.1234, 2080.5678, 151.2912),
    "P2": (1120.1234, 2090.5678, 148.7912),
    "P3": (1060.1234, 2030.5678, 150.4912),
}
"""True coordinates, metres."""
INSTRUMENTS = {"A": 1.563, "S2": 1.611}
POLES = {"A": 1.5, "B": 1.5, "S2": 1.5, "P1": 1.3, "P2": 1.5, "P3": 1.3}
LINES = (("A", "P3"), ("P3", "P1"), ("P1", "S2"), ("S2", "P2"), ("P2", "B"))
LENGTH_KM = 0.08
"""Length of each levelled line."""
BASELINES = (("A", "P2"), ("B", "P1"), ("A", "S2"), ("B", "S2"))
SIGMAS = """
[sigma.direction]
sigma_mgon = 1.0
centring_target_mm = 1.0
[sigma.zenith_angle]
sigma_mgon = 1.2
[sigma.slope_distance]
sigma_mm = 2
ppm = 2
[sigma.height_difference]
sqrt_km_mm = 1.0
sigma_mm = 0.3
[sigma.gnss_vector]
sigma_x_mm = 5
sigma_y_mm = 5
sigma_z_mm = 10
"""


def site(seed: int = 5) -> Project:
    """Return the site without a mistake.

    Args:
        seed: of the errors of the readings.
    """
    rng = np.random.default_rng(seed)
    at = {name: np.array(place) for name, place in PLACES.items()}
    rows: list[Row] = []
    for station, turn in (("A", 50.0), ("S2", 123.0)):
        for target in PLACES:
            if target == station:
                continue
            d = at[target] - at[station]
            d[2] += POLES[target] - INSTRUMENTS[station]
            length = float(np.linalg.norm(d))
            errors = rng.normal(0.0, [1.2e-3, 1.2e-3, 2e-3])
            circle = np.arctan2(d[0], d[1]) / GON - turn + errors[0]
            common = {
                "station": station,
                "target": target,
                "instrument_height": f"{INSTRUMENTS[station]:.3f}",
                "target_height": f"{POLES[target]:.3f}",
            }
            for kind, value in (
                ("direction", circle % 400.0),
                ("zenith_angle", np.arccos(d[2] / length) / GON + errors[1]),
                ("slope_distance", length + errors[2]),
            ):
                rows.append({"kind": kind, **common, "value": f"{value:.4f}"})
    for a, b in LINES:
        rise = f"{at[b][2] - at[a][2] + rng.normal(0.0, 4e-4):.4f}"
        names = {"station": a, "target": b, "value": rise, "length_km": f"{LENGTH_KM:g}"}
        rows.append({"kind": "height_difference", **names})
    for a, b in BASELINES:
        d = at[b] - at[a] + rng.normal(0.0, [5e-3, 5e-3, 1e-2])
        cells = {axis: f"{v:.4f}" for axis, v in zip("xyz", d, strict=True)}
        rows.append({"kind": "gnss_vector", "station": a, "target": b, **cells})
    points = [
        {"name": n, **{a: f"{v:.3f}" for a, v in zip("xyz", PLACES[n], strict=True)}}
        | {"fixed": "xyz"}
        for n in "AB"
    ]
    points += [{"name": n} for n in PLACES if n not in "AB"]
    toml = 'name = "site"\n[units]\nangle = "gon"\n' + SIGMAS
    return Project(toml, {"points.csv": points, "observations.csv": rows})


def book_as(p: Project, station: str, target: str, name: str) -> None:
    """Book a target of a set-up under another name, as if it were another point."""
    for row in p.tables["observations.csv"]:
        if (row["station"], row["target"]) == (station, target) and "instrument_height" in row:
            row["target"] = name
    if all(row["name"] != name for row in p.tables["points.csv"]):
        p.tables["points.csv"].append({"name": name})


SETTINGS = """
adjustment = "3D"
linear = "Meters"
angular = "GONS"
order = "EN"
stations = "AtFromTo"
direction = 1.0
zenith = 1.2
distance = 0.002
distance_ppm = 2
centring_instrument = 0.0
centring_target = 0.001
centring_vertical = 0.0
level = 0.001
weight_levels_by = "length"
refraction = 0.07
"""
"""Settings of the site's STAR*NET file."""


def star_net(p: Project) -> str:
    """Return the held points, the set-ups and the levelled lines as a STAR*NET file."""
    held = [r for r in p.tables["points.csv"] if r.get("fixed")]
    lines = [f"C {r['name']} {r['x']} {r['y']} {r['z']} ! ! !" for r in held] + [".DELTA OFF"]
    sights: dict[tuple[str, str], Row] = {}
    for row in p.tables["observations.csv"]:
        if "instrument_height" in row:
            sight = sights.setdefault((row["station"], row["target"]), dict(row))
            sight[row["kind"]] = row["value"]
    for station in dict.fromkeys(s for s, _ in sights):
        lines.append(f"DB {station}")
        for (at, target), r in sights.items():
            if at == station:
                read = f"{r['direction']} {r['slope_distance']} {r['zenith_angle']}"
                lines.append(f"DM {target} {read} {r['instrument_height']}/{r['target_height']}")
        lines.append("DE")
    for r in p.rows("height_difference"):
        length = 1000.0 * float(r["length_km"])
        lines.append(f"L {r['station']}-{r['target']} {r['value']} {length:g}")
    return "\n".join(lines) + "\n"
