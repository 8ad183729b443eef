"""Displacements of LINZ SNAP's stations: its own listing, grids of known fields, wrong files.

Offsets with the residuals that SNAP prints are of teststof, regression test of github.com/linz/snap
(BSD-3-Clause); all others have numbers of their own.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.io.survey.snap_displacements import read_velocity_grid
from tests.hostile.examples import Example
from tests.loaders.snap_listing import summary

TENTH_MM = 1e-4
PLACE = "36 24 47.91528 S 174 40 11.47217 E 115.596"
OFFSETS = """! offsets of two stations
A enu offset step 2005-03-02 0.50 0.10 -0.20
A height velocity 2005-01-01:12:00:00 0.03
B deformation time_series -0.3 0.5 -0.2 2005-03-02 0.5 0.1 -0.2 2005-03-22 1.0 -0.3 -0.6
"""
STATIONS = f"Two stations\nNZGD2000\nno_geoid\nA {PLACE}\nB {PLACE.replace('47.9', '52.9')}\n"
READINGS = """Positions and a distance
#data GX date no_heights
#gx_enu_error 20 20 30 mm
A -5116779.94 477384.86 -3765265.90 2005-03-07
B -5116700.00 477400.00 -3765400.00 2005-03-10
#date 2005-03-12
#data SD error no_heights
A B 154.2 0.01
"""
JOB = """coordinate_file site.crd
deformation none
station_offset_file site.sto
data_file site.dat
mode data_check
"""
EXAMPLE_FILES = {
    "snap-offsets": Example(
        "snap",
        {"site.snp": JOB, "site.crd": STATIONS, "site.sto": OFFSETS, "site.dat": READINGS},
        "site.snp",
        unread=(
            r"site\.crd\|.*\|Two stations",
            r"site\.crd\|word\|.*\|[AB] 36",  # names of stations
            r"site\.dat\|.*\|Positions",
            r"site\.sto\|.*\|!",
        ),
    )
}


def job(folder: Path, **changed: str) -> Path:
    """Write a job with offsets; return its command file."""
    files = {"site_snp": JOB, "site_crd": STATIONS, "site_sto": OFFSETS, "site_dat": READINGS}
    for name, text in (files | changed).items():
        (folder / name.replace("_", ".")).write_text(text)
    return folder / "site.snp"


def moved(folder: Path, offset: str, date: str) -> np.ndarray:
    """Return e, n, u of an observed position minus its station, which a displacement changes."""
    system = ellipsoid("GRS80")
    phi, lam = -np.radians(36 + 24 / 60 + 47.91528 / 3600), np.radians(174.66985338)
    at = system.to_cartesian(*(np.array([v]) for v in (phi, lam, 115.596)))[0]
    text = "Position\n#gx_enu_error 20 20 30 mm\n#data GX date no_heights\nA "
    text += " ".join(f"{v:.6f}" for v in at) + f" {date}\n"
    network = fga.read(job(folder, site_sto=f"A {offset}\n", site_dat=text))
    (observation,) = network.observations.values()
    station = np.array(network.points["A"].coordinates)
    axes = network.frame.basis(station[None], np.zeros((1, 2))).enu[0]
    return np.asarray(axes @ (np.array(observation.value) - station))


SERIES = (
    "enu deformation time_series -0.3 0.5 -0.2 2005-03-02 0.5 0.1 -0.2 2005-03-22 1.0 -0.3 -0.6"
)


@pytest.mark.published
@pytest.mark.parametrize(
    ("offset", "date", "printed"),
    [
        ("offset 2005-03-02 0.50 0.10 -0.20", "2004-12-25", (0.0, 0.0, 0.0)),
        ("deformation 2005-03-02 0.50 0.10 -0.20", "2005-03-07", (-0.5, -0.1, 0.2)),
        (SERIES, "2004-12-25", (0.3, -0.5, 0.2)),
        (SERIES, "2005-03-07", (-0.625, 0.0, 0.3)),
        (SERIES, "2005-03-30", (-1.0, 0.3, 0.6)),
        # Less what the deformation model of NZGD2000 does to station X001 at the same dates.
        ("xyz offset 2005-03-02 0.5 0.1 -0.2", "2005-03-07", (0.1460, 0.4510, 0.2744)),
        ("height offset 2005-03-02 0.5", "2005-03-07", (0.0, 0.0, -0.5)),
        ("velocity 2001-01-01 0.5 0.1 -0.2", "2004-12-25", (-1.9904, -0.3981, 0.7961)),
    ],
)
def test_offsets_make_the_residuals_of_the_listing(
    tmp_path: Path, offset: str, date: str, printed: tuple[float, ...]
) -> None:
    """teststof, stations X004 to X009: printed residuals, to 0.1 mm."""
    np.testing.assert_allclose(moved(tmp_path, offset, date), printed, atol=1.5 * TENTH_MM)


def test_offsets_of_a_station_add_up(tmp_path: Path) -> None:
    both = "offset 2005-03-02 0.50 0.10 -0.20\nA offset 2006-10-02 0.40 0.20 -0.30"
    found = moved(tmp_path, both, "2006-11-07")
    np.testing.assert_allclose(found, (-0.9, -0.3, 0.5), atol=TENTH_MM)


ALL_KINDS = """Readings of all kinds
#date 12 Mar 2012
#deg_angles
#data SD error
A 1.5 B 1.6 1400.0 0.005
#data HD error no_heights
A C 1390.0 0.005
#data ED error MD error no_heights
B C 1000.0 0.005 1000.1 0.005
#data ZD error
A 1.5 B 1.6 87.6 0.001
#data HA error no_heights
C
A 0.0 0.001
B 70.0 0.001
#end_set
#data AZ error no_heights
A B 135.0 0.001
#data LV error no_heights
A B 60.0 0.005
#data LT error LN error no_heights
B -41.0 0.00001 173.0 0.00001
#data OH error EH error
C 1.2 78.0 0.01 91.0 0.01
#gps_error_type enu
#data GB error no_heights
A C 0.0 0.0 0.0 0.01 0.01 0.01
#data GX error no_heights
B -4784900.0 586500.0 -4158000.0 0.01 0.01 0.01
#reference_frame other
C -4784900.0 586500.0 -4158000.0 0.01 0.01 0.01
"""
TRUE = {"A": (-41.0, 173.0, 120.0), "B": (-41.01, 173.0125, 180.0), "C": (-41.0125, 173.001, 90.0)}


def test_a_displacement_has_the_effect_of_other_coordinates(tmp_path: Path) -> None:
    """All kinds: stations with offsets, and stations that lie where the offsets lead."""
    system = ellipsoid("GRS80")
    by_code = {"A": (0.31, -0.22, 0.41), "B": (-0.2, 0.5, 0.1), "C": (0.05, 0.3, -0.25)}
    squares = []
    for displaced in (True, False):
        lines = ["Stations", "ITRF2008_XYZ", "options deflections geoid_heights"]
        for code, (phi, lam, h) in TRUE.items():
            at = system.to_cartesian(*(np.array([v]) for v in (*np.radians((phi, lam)), h)))[0]
            at = at if displaced else at + np.array(by_code[code])
            lines.append(f"{code} {' '.join(f'{v:.7f}' for v in at)} 4.0 -6.0 12.5")
        offsets = "".join(
            f"{code} xyz 2011-01-01 {x} {y} {z}\n" for code, (x, y, z) in by_code.items()
        )
        commands = "reference_frame other translation 1 2 3 scale 1\n"
        text = JOB + commands
        text = text if displaced else text.replace("station_offset_file site.sto\n", "")
        crd = "\n".join(lines) + "\n"
        network = fga.read(
            job(tmp_path, site_snp=text, site_crd=crd, site_sto=offsets, site_dat=ALL_KINDS)
        )
        assert len(network.observations) == 16
        squares.append(summary(network).squares)
    assert squares[0] == pytest.approx(squares[1], rel=1e-9)
    without = fga.read(job(tmp_path, site_snp=text, site_crd=crd, site_dat=ALL_KINDS))
    assert summary(without).squares == pytest.approx(squares[1], rel=1e-12)


# -- grids ----------------------------------------------------------------------------------------

SHAPE = (5, 6)
STEP = 1e-4


def field(longitude: float, latitude: float) -> tuple[float, float]:
    """Return east and north velocity, linear in both, so that interpolation is exact."""
    return 0.02 + 0.003 * (longitude - 172.0), -0.01 + 0.002 * (latitude + 43.0)


def packed(values: list[int], differences: int, letter: str) -> bytes:
    """Return a row in the whole, as values or as their first or second differences."""
    width = struct.calcsize(letter)
    out = struct.pack("<h", width << 4 | differences << 2)
    given = values
    if differences == 1:
        out += struct.pack("<i", values[0])
        given = [0, *np.diff(values).tolist()]
    elif differences == 2:
        slopes = np.diff(values).tolist()
        out += struct.pack("<2i", values[0], slopes[0])
        given = [0, 0, *np.diff(slopes).tolist()]
    return out + struct.pack(f"<{len(values)}{letter}", *given)


def grid_bytes(version: int, system: str = "ITRF2008", hole: bool = False) -> bytes:
    """Return a grid of the field between 43° and 39° S, 172° and 177° E."""
    nodes = np.array([[field(172.0 + j, -43.0 + i) for j in range(6)] for i in range(5)])
    stored = np.rint(nodes / STEP).astype(int)
    if hole:
        stored[2, 1] = 0x7FFF
    rows = []
    for i, row in enumerate(stored):
        if version == 1:
            rows.append(struct.pack("<12h", *row.ravel().tolist()))
        else:
            parts = [packed(row[:, k].tolist(), i % 3, "bhi"[k + 1]) for k in range(2)]
            rows.append(b"".join(parts))
    begin = f"SNAP grid binary v{version}.0 \r\n\x1a".encode()
    body, places = b"", []
    for row in rows:
        places.append(len(begin) + 4 + len(body))
        body += row
    texts = b"".join(
        struct.pack("<h", len(t) + 1) + t.encode() + b"\0" for t in ("a", "b", "c", system)
    )
    head = struct.pack("<5d4h", -43.0, -39.0, 172.0, 177.0, STEP, *SHAPE, 2, 1)
    index = head + texts + struct.pack("<5i", *places)
    return begin + struct.pack("<i", len(begin) + 4 + len(body)) + body + index


VELOCITY = JOB.replace("station_offset_file site.sto\n", "").replace(
    "deformation none", "deformation type=velocity model=v.grd epoch=2000.0"
)


@pytest.mark.parametrize("version", [1, 2])
def test_velocities_of_a_grid_move_stations(tmp_path: Path, version: int) -> None:
    (tmp_path / "v.grd").write_bytes(grid_bytes(version))
    at = ellipsoid("GRS80").to_cartesian(
        np.radians([-41.25]), np.radians([173.6]), np.array([10.0])
    )[0]
    crd = "Station\nITRF2008\noptions no_geoid degrees ellipsoidal_heights\nA -41.25 173.6 10.0\n"
    text = "Position\n#date 1 Jan 2010\n#gx_enu_error 20 20 30 mm\n#data GX no_heights\nA "
    text += " ".join(f"{v:.6f}" for v in at) + "\n"
    network = fga.read(job(tmp_path, site_snp=VELOCITY, site_crd=crd, site_dat=text))
    (observation,) = network.observations.values()
    station = np.array(network.points["A"].coordinates)
    axes = network.frame.basis(station[None], np.zeros((1, 2))).enu[0]
    found = axes @ (np.array(observation.value) - station)
    east, north = field(173.6, -41.25)
    # Nodes are rounded to 0.1 mm a year.
    np.testing.assert_allclose(found, (-10 * east, -10 * north, 0.0), atol=10 * 0.5 * STEP)
    still = fga.read(tmp_path / "site.snp", deformation="none")
    assert next(iter(still.observations.values())).value == pytest.approx(at, abs=1e-6)


def test_a_node_without_a_value_has_none(tmp_path: Path) -> None:
    (tmp_path / "v.grd").write_bytes(grid_bytes(1, hole=True))
    grid = read_velocity_grid(tmp_path / "v.grd")
    assert np.isnan(grid.values).sum() == 2
    for place in ((-40.5, 173.5), (-41.0, 173.0)):
        with pytest.raises(fga.InputError, match=r"the grid v\.grd has no value at station 'A'"):
            grid.at(*np.radians(place), "A")
    # On the line of nodes beside it the empty node has no part.
    assert np.isfinite(grid.at(*np.radians((-40.0, 173.0)), "A")).all()
    with pytest.raises(fga.InputError, match=r"station 'A' is outside of the grid v\.grd"):
        grid.at(*np.radians((-43.5, 173.0)), "A")


@pytest.mark.parametrize("version", [1, 2])
def test_a_grid_that_is_cut_off_is_refused_wherever(tmp_path: Path, version: int) -> None:
    whole = grid_bytes(version)
    for size in range(len(whole)):
        (tmp_path / "v.grd").write_bytes(whole[:size])
        with pytest.raises(fga.InputError):
            read_velocity_grid(tmp_path / "v.grd")


@pytest.mark.parametrize(
    ("changed", "problem"),
    [
        ({"site_sto": "A 2005-13-02 1 2 3\n"}, "site.sto:1: date '2005-13-02' is none; valid: 20"),
        ({"site_sto": "A xyz 2005-03-02 1 2\n"}, "site.sto:1: offset in xyz is missing"),
        ({"site_sto": "A 2005-03-02 1 2 3 4\n"}, "site.sto:1: has 1 words too many, from '4'"),
        ({"site_sto": "A time_series 1 2 3\n"}, "site.sto:1: date '' is none"),
        (
            {"site_sto": "A time_series 1 2 3 2005-03-02 1 2 3 2005-03-01 1 2 3\n"},
            "site.sto:1: the date 2005-03-01 must be later than the one before",
        ),
        ({"site_snp": JOB.replace("site.sto", "b.sto")}, "the station offset file 'b.sto' is not"),
        ({"site_snp": JOB.replace("site.sto", "site.sto x")}, "is the only word, not 'x' behind"),
        ({"site_snp": JOB + "recode A to C\n"}, "station 'A' has offsets and is recoded"),
        (
            {"site_dat": READINGS.replace("#date 2005-03-12\n", "")},
            "site.dat:7: station 'A' moves, and the reading has no date",
        ),
        ({"site_snp": VELOCITY.replace("v.grd", "w.grd")}, "the velocity grid (model=FILE) is not"),
        ({"site_snp": VELOCITY.replace("=2000.0", "=soon")}, "epoch must be a date"),
        ({"site_snp": VELOCITY.replace("=2000.0", "=2000 a=b")}, "deformation must be none, datum"),
        ({"site_snp": VELOCITY}, "velocities in ITRF2008 and stations in NZGD2000"),
    ],
)
def test_wrong_displacements_are_refused_with_their_lines(
    tmp_path: Path, changed: dict[str, str], problem: str
) -> None:
    (tmp_path / "v.grd").write_bytes(grid_bytes(1))
    with pytest.raises(fga.InputError) as caught:
        fga.read(job(tmp_path, **changed))
    assert problem in str(caught.value)


def test_offsets_of_stations_that_the_job_lacks_are_left_out(tmp_path: Path) -> None:
    text = OFFSETS + "X offset 2005-03-02 1 2 3\n"
    network = fga.read(job(tmp_path, site_sto=text))
    (left,) = (left for left in network.left_out if left.what == "offsets of stations")
    assert left.names == ("X",)
