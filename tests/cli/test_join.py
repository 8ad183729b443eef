"""The command join reads several files, each with its options, and writes one network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main

CONTROL = {
    "A": (690000.0, 5340000.0, 520.0),
    "B": (691500.0, 5340300.0, 541.0),
    "C": (690700.0, 5341400.0, 533.0),
}
NEW = {"P": (690600.0, 5340700.0, 528.0), "Q": (691200.0, 5341000.0, 536.0)}
UNDULATION = 46.12
TENTH_MM = 1e-4


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write two errorless tables of sights in UTM, a levelled line and vectors of GNSS."""
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    monkeypatch.chdir(tmp_path)
    system = fga.ReferenceSystem("EPSG:25832", geoid=UNDULATION)
    places = {**CONTROL, **NEW}
    phi, lam, h = system.to_geodetic(np.array(list(places.values())))
    at = system.ellipsoid.to_cartesian(phi, lam, h)
    xyz = dict(zip(places, at, strict=True))
    origins = dict(zip(places, zip(phi, lam, h, strict=True), strict=True))
    for file, targets in (("one", "ABCQ"), ("two", "ACQ")):
        rows = ["station;target;direction;zenith;distance"]
        for target in targets:
            there = fga.TopocentricFrame(*origins["P"]).from_geocentric(xyz[target][None])[0]
            beta = np.arctan2(there[2], np.hypot(*there[:2]))
            beta += 0.13 * np.hypot(*there[:2]) / 2 / 6371000
            reading = (np.arctan2(there[0], there[1]) + (file == "two")) % (2 * np.pi)
            rows.append(
                f"P;{target};{reading:.12f};{np.pi / 2 - beta:.12f};{np.linalg.norm(there):.6f}"
            )
        Path(f"{file}.csv").write_text("\n".join(rows), encoding="utf-8")
    fixed = [f"{n};{e};{k};{z};yes" for n, (e, k, z) in CONTROL.items()]
    Path("points.csv").write_text("\n".join(["name;x;y;z;fixed", *fixed]), encoding="utf-8")
    readings = '[readings]\nstation = "station"\ntarget = "target"\ndirection = "direction"\n'
    readings += 'zenith = "zenith"\ndistance = "distance"\n'
    known = '[points]\nfile = "points.csv"\nname = "name"\nx = "x"\ny = "y"\nz = "z"\n'
    unit = '[units]\nangle = "rad"\n'
    Path("known.toml").write_text(f'{unit}{known}fixed = "fixed"\n{readings}', encoding="utf-8")
    Path("plain.toml").write_text(f"{unit}{readings}", encoding="utf-8")
    Path("level.gsi").write_text(
        "*110001+000000000000000A 32...8+0000000060000000 331.28+0000000000920000 \n"
        "*110002+000000000000000P 32...8+0000000060000000 332.28+0000000000120000 \n",
        encoding="utf-8",
    )
    gnss = fga.Network("gnss", frame=fga.GeocentricFrame())
    for name in "AQ":
        gnss.add_point(name, xyz[name])
    gnss.add(fga.GnssVector("A", "Q", tuple(xyz["Q"] - xyz["A"]), sigma=(0.003,) * 3))
    fga.write_gvx(gnss, "v.gvx", reference_system_id=126, reference_system="ETRS89")
    return tmp_path


SETTINGS = ("--set", "one.csv:mapping=known.toml", "--set", "two.csv:mapping=plain.toml")


def test_books_a_level_and_vectors_become_a_project_in_a_grid(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inputs = ("one.csv", "two.csv", "level.gsi", "v.gvx", "site/project.toml")
    grid = ("--crs", "EPSG:25832", "--geoid", str(UNDULATION))
    assert main(["join", *inputs, *SETTINGS, *grid]) == 0
    said = capsys.readouterr().out
    assert said == (
        "site/project.toml: 5 points, 0 photos, 0 image points and 23 other observations of "
        "4 files\n"
    )
    network = fga.read("site")
    assert isinstance(network.frame, fga.GeocentricFrame)
    assert list(network.orientations) == [("P", "1"), ("P", "2")]
    solution = fga.adjust(network)
    assert solution.sigma0 < 0.05
    found = fga.grid_coordinates(solution)
    for name, place in NEW.items():
        np.testing.assert_allclose(found.point(name), place, rtol=0, atol=TENTH_MM)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("one.csv", "none.gsi"), "none.gsi: no such file or folder"),
        (("one.csv", "two.csv", "--set", "on.csv:ppm=1"), "'on.csv:ppm=1' is of no file that"),
        (("one.csv", "two.csv", *SETTINGS, "--set", "pmm=1"), "the option 'pmm'; they have: "),
        (("level.gsi", "v.gvx"), "or with --crs"),
        (("level.gsi", "level.gsi"), "level.gsi: is named twice: a file is joined once"),
        (("level.gsi", "two.csv", "--geoid", "46"), "state the reference system too, --crs"),
    ],
)
def test_what_is_wrong_is_told_and_nothing_is_written(
    files: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    inputs = [a for a in arguments if not a.startswith("-")]
    at = next((i for i, a in enumerate(arguments) if a.startswith("-")), len(inputs))
    assert main(["join", *arguments[:at], "out/p.toml", *arguments[at:]]) == 2
    assert message in capsys.readouterr().err
    assert not Path("out").exists()
