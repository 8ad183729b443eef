"""DynAdjust beside its listings: ``python -m tests.benchmarks.dynadjust_samples FOLDER [TABLE]``.

FOLDER is sampleData of github.com/icsm-au/DynAdjust (Apache-2.0); TABLE, a geoid by stations, is
written. Prints what is read of each network, and n, u, r, χ², χ²/r and global reliability of the
networks gnss and urban beside those of the listings.

The listing of urban was made by version 1.0.3, whose terms differ in three places:

- it applies the deflections to zenith angles (V) with the wrong sign (to vertical angles, Z, with
  the right one; later versions correct it);
- it sets targets of slope distances up along the normal of the instrument's station, and
  instruments along normals, not plumb lines;
- within two cells of the edge of a geoid grid it repeats nodes, so that slopes of N, ξ, η jump.

Each is put in turn into the readings, until the listing is met. Its global reliability contains a
standard deviation of 10 m of every free station, which controls nearly uncontrolled measurements;
stations of two blocks of a phased adjustment have it twice.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.crs.geoid import Ntv2Geoid, SubGrid, geoid
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC
from tests.loaders.dynadjust import read_listing, read_rows, read_summary

MAX_STABLE = 700.0
"""Largest reliability of a measurement that counts in the global one, as in DynAdjust."""
FREE_STATION_M = 10.0
"""Standard deviation of free stations in DynAdjust, metres."""
CONSTRAINT_M = 2e-6
"""σ of observed constraints lie below, metres."""
NO_HEIGHTS = {"heights": "ellipsoidal"}


def normals(network: fga.Network, name: str, *, plumb: bool = False) -> Array:
    """Return east, north, up (3, 3) at a station, of the normal or of the plumb line."""
    held = network.of_kind("vertical").get(name)
    tilt = np.array([held.values if plumb and held is not None else (0.0, 0.0)])
    return np.asarray(network.frame.basis(np.array([place(network, name)]), tilt).enu[0])


def place(network: fga.Network, name: str) -> Array:
    return np.array(network.points[name].coordinates)


def with_sign_of_103(network: fga.Network) -> None:
    """Give zenith angles the deflections with the sign of version 1.0.3."""
    for ident, o in list(network.observations.items()):
        held = network.of_kind("vertical").get(getattr(o, "station", ""))
        if isinstance(o, fga.ZenithAngle) and held is not None:
            q = normals(network, o.station) @ (place(network, o.target) - place(network, o.station))
            alpha = np.arctan2(q[0], q[1])
            xi, eta = held.values
            turned = 2.0 * float(xi * np.cos(alpha) + eta * np.sin(alpha))
            network.observations[ident] = replace(o, value=o.value - turned)


def with_setups_of_103(network: fga.Network) -> None:
    """Set instruments and targets of slope distances up along the normal of the station."""
    for ident, o in list(network.observations.items()):
        if type(o) is not fga.SlopeDistance:
            continue
        d = place(network, o.target) - place(network, o.station)
        here, there = (normals(network, n, plumb=True)[2] for n in (o.station, o.target))
        ours = d + o.target_height * there - o.instrument_height * here
        theirs = d + (o.target_height - o.instrument_height) * normals(network, o.station)[2]
        shift = float(np.linalg.norm(ours) - np.linalg.norm(theirs))
        network.observations[ident] = replace(o, value=o.value + shift)


def edge_table(network: fga.Network, grid: Path, table: Path) -> None:
    """Write N, ξ and η of the stations as DynAdjust interpolates them near the edge of a grid."""
    found = geoid(str(grid))
    assert isinstance(found, Ntv2Geoid)
    (cells,) = found.grids
    lines = ["point,n,xi,eta"]
    frame = network.frame
    assert isinstance(frame, fga.GeocentricFrame)
    for name in network.points:
        latitude, longitude, _ = frame.ellipsoid.to_geodetic(place(network, name))
        n, xi, eta = at_edge(cells, float(latitude), float(longitude)).tolist()
        lines.append(f"{name},{n!r},{xi / ARCSEC!r},{eta / ARCSEC!r}")
    table.write_text("\n".join(lines) + "\n")


def at_edge(grid: SubGrid, latitude: float, longitude: float) -> Array:
    """Return N, ξ, η (3,): bicubic, of nodes that are replaced within two cells of an edge.

    The order of the replacements is that of dnageoid.cpp.
    """
    rows, columns, _ = grid.values.shape
    v = (latitude - grid.south) / grid.latitude_step
    u = (-longitude - grid.east) / grid.longitude_step
    i, j = int(v + 1e-9), int(u + 1e-9)
    # P O N M / L D C K / J B A I / H G F E, from the north and the west
    at = {k: (r, c) for r, row in enumerate(("EFGH", "IABJ", "KCDL", "MNOP"), -1)
          for c, k in enumerate(row, -1)}  # fmt: skip
    low, high = v < 2.0, rows - 1 - v < 2.0
    right, left = u < 2.0, columns - 1 - u < 2.0
    for test, moves in (
        (low and right, "IA KC MN EI FA GB HJ"),
        (low and left, "JB LD PO EI FA GB HJ"),
        (low, "EI FA GB HJ"),
        (high and right, "KC IA EF MK NC OD PL"),
        (high and left, "LD JB PO MK NC OD PL"),
        (high, "MK NC OD PL"),
        (right, "EF IA KC MN"),
        (left, "HG JB LD PO"),
    ):
        if test:
            for pair in moves.split():
                at[pair[0]] = at[pair[1]]
            break
    flat = grid.values.reshape(-1, 3)
    # Nodes are numbered on, row by row: beyond the end of a row lies the begin of the next.
    node = {k: flat[min(max((i + r) * columns + j + c, 0), len(flat) - 1)]
            for k, (r, c) in at.items()}  # fmt: skip
    t, w = j + 1 - u, v - i
    corners = ("B", "A", "D", "C")  # of t = 0, 1 and w = 0, 1
    value = {c: node[c] for c in corners}
    by_t = {"B": ("A", "J"), "A": ("I", "B"), "C": ("K", "D"), "D": ("C", "L")}
    by_w = {"B": ("D", "G"), "A": ("C", "F"), "C": ("N", "A"), "D": ("O", "B")}
    both = {"B": "CFLH", "A": "KEDG", "C": "MIOB", "D": "NAPJ"}
    out = np.zeros(3)
    for c, (x, y) in {"B": (0, 0), "A": (1, 0), "D": (0, 1), "C": (1, 1)}.items():
        slope_t = (node[by_t[c][0]] - node[by_t[c][1]]) / 2.0
        slope_w = (node[by_w[c][0]] - node[by_w[c][1]]) / 2.0
        p, q, r, s = (node[k] for k in both[c])
        twist = (p - q - r + s) / 4.0
        (a, b), (d, e) = hermite(t, x), hermite(w, y)
        out += a * d * value[c] + b * d * slope_t + a * e * slope_w + b * e * twist
    return out


def hermite(t: float, end: int) -> tuple[float, float]:
    """Return the weights of value and slope at an end, 0 or 1, of a cell."""
    if end == 0:
        return (1 + 2 * t) * (1 - t) ** 2, t * (1 - t) ** 2
    return t * t * (3 - 2 * t), t * t * (t - 1)


def pelzer(solution: Solution) -> float:
    """Return the global reliability, √ of the mean of σ²/σ_v² − 1 of measurements, σ_v of v."""
    found = []
    for _, sigma, after in statistics(solution):
        relative = sigma / after if after > 0 else np.inf
        if relative < MAX_STABLE:
            found.append(relative**2 - 1.0)
    return float(np.sqrt(np.mean(found)))


def statistics(solution: Solution) -> list[tuple[float, float, float]]:
    """Return v, σ and σ_v of all measurements without constraints, in the order of the file."""
    network, equations = solution.network, solution.equations
    v = equations.residuals(solution.state, whitened=False)
    r, sigmas = fga.reliability(solution).redundancy_numbers, equations.sigmas()
    rows: dict[str, list[int]] = {}
    for row in range(equations.n_rows):
        rows.setdefault(equations.id(row), []).append(row)
    out = []
    for ident, o in network.observations.items():
        own = rows[ident]
        if o.kind == "control" and (
            not CONSTRAINT_M < min(o.sigma or (1.0,)) < FREE_STATION_M  # type: ignore[attr-defined]
        ):
            continue
        given = sigmas[own]
        after = given * np.sqrt(np.maximum(r[own], 0.0))
        covariance = getattr(o, "covariance", None)
        if covariance is not None:
            ends = o.points()
            adjusted = solution.covariance(ends[-1])
            if len(ends) == 2:
                cross = solution.covariance(ends[0], ends[1])
                adjusted = adjusted + solution.covariance(ends[0]) - cross - cross.T
            given = np.sqrt(np.diag(covariance))
            after = np.sqrt(np.maximum(np.diag(covariance - adjusted), 0.0))
        out += [
            (float(a), float(b), float(c)) for a, b, c in zip(v[own], given, after, strict=True)
        ]
    return out


def compared(title: str, solution: Solution, listing: Path) -> None:
    """Print figures of an adjustment beside those of a listing."""
    theirs, rows = read_summary(listing), read_rows(listing)
    stations = read_listing(listing)[1]
    found = statistics(solution)
    held = solution.n_unknowns - int(theirs["unknowns"])  # constraints are unknown and observed
    figures = (
        f"n {solution.n_observations - held}/{theirs['measurements']:.0f} "
        f"u {solution.n_unknowns - held}/{theirs['unknowns']:.0f} "
        f"r {solution.redundancy}/{theirs['redundancy']:.0f} "
        f"χ² {solution.vtpv:.2f}/{theirs['squares']:.2f} "
        f"χ²/r {solution.vtpv / solution.redundancy:.3f}/{theirs['variance']:.3f} "
        f"Pelzer {pelzer(solution):.3f}/{theirs['pelzer']:.3f}"
    )
    away = max(float(np.abs(solution.point(n) - s.xyz).max()) for n, s in stations.items())
    residuals, tests = [0.0], [0.0]
    for row, (v, sigma, after) in zip(rows, found, strict=True):
        if row.kind == "Y" and row.component in "PLH":
            continue  # v in latitude, longitude, height
        residuals.append(abs(v / sigma - row.correction / row.sigma))
        if row.pelzer < MAX_STABLE and after > 0:
            tests.append(abs(v / after - row.statistic))
    print(f"{title:48} {figures}")
    print(
        f"{'':48} largest differences: coordinates {1000 * away:.2f} mm, residuals "
        f"{max(residuals):.3f} σ, N {max(tests):.2f}; medians {np.median(residuals):.4f} σ, "
        f"{np.median(tests):.4f}"
    )


def what_is_read(title: str, read: Callable[[], fga.Network]) -> None:
    """Print stations and observations of a file, or why it is refused."""
    try:
        network = read()
    except fga.InputError as error:
        print(f"{title:48} refused: {str(error).splitlines()[0]}")
        return
    kinds = Counter(o.kind for o in network.observations.values())
    off = sum(left.count for left in network.left_out)
    print(f"{title:48} {len(network.points)} stations, {dict(kinds)}, {off} left out")


def main() -> None:
    """Print the tables."""
    folder = Path(sys.argv[1])
    text, xml = fga.read_dynadjust, fga.read_dynaml
    grid = folder / "urban-network-geoid.gsb"
    plan = {"driver": True, **NO_HEIGHTS}
    for title, stations, measurements, options in (
        ("gnss", "gnss-network.stn", None, {}),
        ("urban", "urban-network.stn", None, {"geoid": str(grid)}),
        ("urban in GDA2020", "urban.GDA2020.1.1.2020.stn", None, {"geoid": str(grid)}),
        ("urban without a geoid", "urban-network.stn", None, {}),
        ("dsg", "dsg.stn", None, NO_HEIGHTS),
        ("dsg, retained", "dsg.stn", "dsg-retained.msr", NO_HEIGHTS),
        ("dsg, ignored", "dsg.stn", "dsg-ignored.msr", NO_HEIGHTS),
        ("skye", "skye-tutorial.stn", None, {}),
        ("apr", "apr.ITRF2008.04.06.2020.stn", None, {}),
        ("simulate", "simulate.stn", "simulation-driver.msr", plan),
        ("pseudo", "pseudo.stn", "pseudo-driver-file.msr", plan),
        ("sa-gnss", "sa-gnss-stn.xml", "sa-gnss-msr.xml", {}),
        ("allignored", "stn_allignored.xml", "msr_allignored.xml", NO_HEIGHTS),
    ):
        read = xml if stations.endswith(".xml") else text
        other = None if measurements is None else folder / measurements
        what_is_read(
            title,
            lambda read=read, s=stations, m=other, o=options: read(folder / s, measurements=m, **o),  # type: ignore[misc]
        )
    listing = folder / "gnss.simult.adj.expected"
    for title, network in (
        ("gnss, columns", text(folder / "gnss-network.stn", reference_frames="by GDA94")),
        ("gnss, DynaML", xml(folder / "gnss-networkstn.xml", reference_frames="by GDA94")),
    ):
        compared(title, fga.adjust(network), listing)
    listing = folder / "urban.phased.adj.expected"
    network = text(folder / "urban-network.stn", geoid=str(grid))
    compared("urban", fga.adjust(network), listing)
    with_sign_of_103(network)
    compared("… sign of deflections in V", fga.adjust(network), listing)
    with_setups_of_103(network)
    compared("… set-ups of slope distances", fga.adjust(network), listing)
    table = Path(sys.argv[2] if len(sys.argv) > 2 else "urban-geoid.csv")
    edge_table(network, grid, table)
    network = text(folder / "urban-network.stn", geoid=str(table))
    with_sign_of_103(network)
    with_setups_of_103(network)
    solution = fga.adjust(network)
    compared("… edge of the geoid grid", solution, listing)
    for name, point in network.points.items():
        if not all(point.fixed):
            at = tuple(solution.point(name).tolist())
            network.add(fga.ControlPoint(name, at, sigma=(FREE_STATION_M,) * 3))
    found = f"{pelzer(fga.adjust(network)):.3f}/{read_summary(listing)['pelzer']:.3f}"
    print(f"{'… 10 m of free stations':48} Pelzer {found}")


if __name__ == "__main__":
    main()
