"""The loop of a site: adjusted, the next epoch planned, measured again, compared; by commands."""

from __future__ import annotations

import shlex
import tomllib

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main

KNOWN = {"A": (0, 0, 100), "B": (80, 10, 101), "C": (70, 75, 103), "E": (-10, 70, 102)}
NEW = {
    **{"S": (20, 25, 100.5), "T": (55, 45, 101)},
    **{"D1": (40, 60, 104), "D2": (60, 20, 102.5), "D3": (25, 50, 103)},
}
MOVED = np.array((0.007, -0.004, -0.012))
SIGMAS = {
    **{"sigma_direction_mgon": 0.5, "sigma_zenith_mgon": 0.5, "sigma_distance_mm": 0.8},
    **{"ppm": 0, "centring_mm": 0.2, "refraction": "none"},
}
SET = [word for name, value in SIGMAS.items() for word in ("--set", f"{name}={value}")]


def book(path, seed, places, *, known):
    """Write a book in GSI-16: two stations, all targets in face 1, above a plane."""
    rng = np.random.default_rng(seed)
    lines: list[str] = []

    def block(name, **words):
        number = f"*11{len(lines) + 1:04d}+{name:0>16} "
        lines.append(
            number
            + "".join(
                f"{w}{'-' if v < 0 else '+'}{abs(round(v)):016d} "
                for w, v in ((k[1:].replace("_", "."), v) for k, v in words.items())
            )
        )

    for n in known:
        x, y, z = 1e3 * np.array(places[n], float)
        block(n, _81___0=x, _82___0=y, _83___0=z)
    for station in "ST":
        block(station, _88___0=1600)
        turned = rng.uniform(0, 400)
        for n in places:
            if n == station:
                continue
            d = np.subtract(places[n], places[station])
            d = np.add(d, np.array((0, 0, 1.5 - 1.6)))
            plan, slope = np.hypot(*d[:2]), np.linalg.norm(d)
            direction = np.arctan2(d[0], d[1]) / fga.GON - turned + rng.normal(0, 0.0005)
            zenith = np.arctan2(plan, d[2]) / fga.GON + rng.normal(0, 0.0005)
            read = {"_21_322": 1e5 * (direction % 400), "_22_322": 1e5 * zenith}
            block(n, **read, _31___6=1e4 * (slope + rng.normal(0, 0.0008)), _87___0=1500)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.fixture
def site(tmp_path, monkeypatch):
    """The folder of a site with the books of two epochs; the second has no coordinates."""
    monkeypatch.chdir(tmp_path)
    first = {**KNOWN, **NEW}
    book(tmp_path / "spring.gsi", 1, first, known=KNOWN)
    second = {n: p for n, p in first.items() if n != "D3"} | {"D4": (62, 40, 103.2)}
    second["D1"] = tuple(np.add(NEW["D1"], MOVED))
    book(tmp_path / "autumn.gsi", 2, second, known=())
    assert main(["new", "site", "spring.gsi", "--set", "fixed=A,B,C,E", *SET, "--yes"]) == 0
    return tmp_path


def test_each_command_takes_the_output_of_the_one_before(site, capsys):
    assert main(["plan", "site"]) == 2
    said = capsys.readouterr().err
    assert "5 problems" in said
    adjusting = said.splitlines()[-1].partition(": ")[2].partition(" writes")[0]
    planning = said.rstrip().rpartition("then: ")[2]
    assert planning == "factorgraph-adj plan next"

    # The commands of the message, as they stand there.
    assert main(shlex.split(adjusting)[1:]) == 0
    capsys.readouterr()
    assert main(shlex.split(planning)[1:]) == 0
    assert "redundancy" in capsys.readouterr().out

    assert main(["new", "autumn", "autumn.gsi", "--points-from", "next", *SET, "--yes"]) == 0
    said = capsys.readouterr().out
    assert "8 points have the coordinates of next; its datum: 4 held" in said
    assert "not in these files, and left out: D3" in said
    assert "not in next: D4" in said
    assert "held: A, B, C, E" in said
    made, adjusted = fga.read("autumn"), fga.read("next")
    assert made.name == "autumn"
    assert set(made.points) == {*KNOWN, *NEW, "D4"} - {"D3"}
    for name in set(made.points) - {"D4"}:
        assert made.points[name] == adjusted.points[name]
    assert len(made.observations) == len(fga.read("autumn.gsi").observations)
    heading = (site / "autumn" / "project.toml").read_text(encoding="utf-8")
    assert "# Coordinates and datum of points are those of next." in heading

    out = ["--out", "result"]
    assert main(["compare", "site", "autumn", "--objects", "D1,D2", *out]) == 0
    found = fga.congruence(fga.adjust(fga.read("site")), fga.adjust(made), objects=["D1", "D2"])
    assert found.moved == ("D1",)
    shift = found.displacement("D1")
    assert np.all(np.abs(shift.vector - MOVED) < 3 * shift.sigmas)
    said = capsys.readouterr().out
    assert "Held in both epochs" in said
    assert "A, B, C, E" in said


def test_the_command_of_the_message_has_the_options_of_reading(site, capsys):
    given = ["--set", "fixed=A,B,C,E", *SET]
    assert main(["plan", "spring.gsi", *given]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    command = shlex.split(said.partition(": ")[2].partition(" writes")[0])
    assert command[1:] == ["adjust", "spring.gsi", *given, "--export", "next/project.toml"]


def test_a_design_without_readings_is_not_sent_to_adjust(site, capsys):
    table = site / "site" / "observations.csv"
    rows = [line.split(",") for line in table.read_text(encoding="utf-8").splitlines()]
    value = rows[0].index("value")
    kept = [",".join(c for i, c in enumerate(r) if i != value) for r in rows]
    table.write_text("\n".join(kept) + "\n", encoding="utf-8")
    assert main(["plan", "site"]) == 2
    said = capsys.readouterr().err
    assert "a plan needs its coordinates" in said
    assert "--export" not in said


def test_join_takes_the_points_of_another_project_too(site, capsys):
    assert main(["adjust", "site", "--export", "next/project.toml", "--quiet"]) == 0
    command = ["join", "autumn.gsi", "joined/project.toml", "--points-from", "next", *SET]
    assert main(command) == 0
    assert "8 points have the coordinates of next; its datum: 4 held" in capsys.readouterr().out
    joined = fga.read("joined")
    assert {n for n, p in joined.points.items() if p.held} == set(KNOWN)
    assert joined.datum == "given"


def test_points_that_cannot_be_taken_are_refused(site, capsys):
    new = ["new", "autumn", "autumn.gsi", "--yes", "--points-from"]
    assert main([*new, "none"]) == 2
    assert "none: no such file or folder" in capsys.readouterr().err
    other = fga.Network("other")
    other.add_point("Z", (0, 0, 0), fixed="xyz")
    fga.write_project(other, "other/project.toml")
    assert main([*new, "other"]) == 2
    assert "has none of the points of the files; it has Z, they have" in capsys.readouterr().err
    # Both hold A, at different places.
    other.add_point("A", (0, 0, 101), fixed="xyz")
    fga.write_project(other, "held/project.toml")
    again = [
        "new",
        "again",
        "spring.gsi",
        "--set",
        "fixed=A",
        *SET,
        "--points-from",
        "held",
        "--yes",
    ]
    assert main(again) == 2
    assert "z is 101 m, held in 'other' and 100 m, held in 'spring'" in capsys.readouterr().err
    assert not (site / "autumn").exists()
    assert not (site / "again").exists()


def test_free_datum_points_are_carried_over(site, capsys):
    text = (site / "site" / "project.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["datum"] == "given"
    first = fga.read("spring.gsi", **{**SIGMAS, "refraction": None})
    free = fga.Network("free", datum="free")
    for name, place in {**KNOWN, **NEW}.items():
        free.add_point(name, place, datum=name in "ABC")
    fga.write_project(free, "free/project.toml")
    assert first.datum == "free"
    assert main(["new", "autumn", "autumn.gsi", "--points-from", "free", *SET, "--yes"]) == 0
    assert "of free; its datum: 3 datum points" in capsys.readouterr().out
    made = fga.read("autumn")
    assert made.datum == "free"
    assert [n for n, p in made.points.items() if p.datum] == ["A", "B", "C"]
