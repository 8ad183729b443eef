"""``collocate``: the corrections of the function in files, doubts, and what is refused."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from examples.papers.methods_1980_block import simulated_block
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.collocation.point_corrections import point_corrections
from tests.networks.deformed_heights import SIGNAL, levelled


@pytest.fixture
def project(tmp_path: Path) -> str:
    fga.write_project(levelled()[0], tmp_path / "block" / "project.toml")
    return str(tmp_path / "block")


def test_the_files_have_the_corrections(
    project: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    stated = f"gaussian:{SIGNAL.sigma},{SIGNAL.length}"
    options = ["--covariance", "none", "--height", stated, "--trend", "mean", "--out", str(out)]
    assert main(["collocate", project, *options]) == 0
    said = capsys.readouterr().out
    assert "up: covariance function gaussian, σ 0.03 m, L 400 m, stated." in " ".join(said.split())
    expected = point_corrections(
        fga.adjust(fga.read_project(project)), covariance=None, height=SIGNAL, trend="mean"
    )
    with (out / "corrections.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [r["name"] for r in rows] == list(expected.names)
    found = np.array([[float(r[k]) for k in ("z", "du_mm", "sigma_u_mm")] for r in rows])
    own = [expected.coordinates[:, 2], expected.prediction.values[:, 2], expected.sigmas[:, 2]]
    np.testing.assert_allclose(found, np.column_stack(own) * [1.0, 1e3, 1e3], rtol=1e-7)
    with (out / "known_points.csv").open(encoding="utf-8") as file:
        known = list(csv.DictReader(file))
    numbers = [float(r["redundancy"]) + float(r["redundancy_signal"]) for r in known]
    assert len(known) == 15 and sum(numbers) == pytest.approx(14.0)
    assert "Corrected points" in (out / "collocation.txt").read_text(encoding="utf-8")


def test_a_function_is_estimated_or_refused(
    project: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--covariance", "none", "--height", "matern52", "--alpha", "0.2"]
    assert main(["collocate", project, *options]) == 0
    assert "matern52" in capsys.readouterr().out
    calm, _, _ = levelled()
    rng = np.random.default_rng(1)
    for ident, o in list(calm.observations.items()):
        if isinstance(o, fga.ControlPoint):
            z = calm.points[o.point].coordinates[2] + rng.normal(scale=0.008)
            calm.observations[ident] = fga.ControlPoint(o.point, (z,), axes="z", sigma=(0.008,))
    fga.write_project(calm, tmp_path / "calm" / "project.toml")
    assert (
        main(["collocate", str(tmp_path / "calm"), "--covariance", "none", "--height", "gaussian"])
        == 2
    )
    assert "no signal that noise does not explain" in capsys.readouterr().err


def test_images_are_corrected_by_a_grid_in_the_written_project(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fga.write_project(simulated_block().network, tmp_path / "block" / "project.toml")
    out = tmp_path / "out"
    assert main(["collocate", str(tmp_path / "block"), "--images", "1", "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Camera camera: covariance function gaussian" in said and "21 × 21 nodes" in said
    again = fga.read_project(out)
    assert again.cameras["camera"].lens.kind == "grid"
    printed = float(said.split("Bundle 2: σ̂0 ")[1].split()[0].rstrip("."))
    assert fga.adjust(again).sigma0 == pytest.approx(printed, abs=1e-4)


def test_heights_have_the_function_of_the_plan_by_default(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    network = fga.Network("shifted checks")
    rng = np.random.default_rng(4)
    for i, x in enumerate(rng.uniform(0.0, 900.0, (8, 3))):
        network.add_point(f"P{i}", x, fixed="xyz", check=x + np.array([0.02, 0.0, 0.01]))
    network.add_point("Q", (1.0, 2.0, 3.0))
    network.add(fga.GnssVector("P0", "Q", (1.0, 2.0, 3.0), sigma=(0.01,) * 3))
    fga.write_project(network, tmp_path / "project.toml")
    options = ["--use", "check", "--covariance", "hirvonen:0.01,300", "--noise", "0.005"]
    assert main(["collocate", str(tmp_path), *options]) in (0, 1)
    said = capsys.readouterr().out
    assert said.count("hirvonen, σ 0.01 m, L 300 m, stated") == 2


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("gausian", "is unknown; valid: gaussian"),
        ("gaussian:1", "is not KIND:SIGMA,LENGTH"),
        ("gaussian:1,-5", "length must be greater than zero"),
    ],
)
def test_a_wrong_function_is_said(word: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["collocate", "p", "--covariance", word])
    assert said in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("columns", ["", ",sigma_mm", ",fixed"])
def test_points_of_a_plan_need_no_observations(
    columns: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(6)
    where = rng.uniform(0.0, 1500.0, (40, 2))
    off = rng.multivariate_normal(np.zeros(40), SIGNAL.between(where), size=2, method="eigh").T
    known = where + off + rng.normal(scale=0.01, size=off.shape)
    cell = {"": "", ",sigma_mm": ",10", ",fixed": ",xy"}[columns]
    lines = [f"name,x,y{columns},check_x,check_y"]
    for i, (at, there) in enumerate(zip(where, known, strict=True)):
        check = f"{there[0]},{there[1]}" if i < 30 else ","
        lines.append(f"P{i},{at[0]},{at[1]}{cell},{check}")
    (tmp_path / "project.toml").write_text('name = "plan"\ndimension = 2\n', encoding="utf-8")
    (tmp_path / "points.csv").write_text("\n".join(lines), encoding="utf-8")
    assert main(["collocate", str(tmp_path), "--use", "check", "--out", str(tmp_path / "o")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    noise = float(said.split("together with the noise, σ ")[1].split()[0])
    assert 0.007 < noise < 0.014 and "heights" not in said
    with (tmp_path / "o" / "corrections.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 40 and "z" not in rows[0] and "du_mm" not in rows[0]
    predicted = np.array([[float(r["de_mm"]), float(r["dn_mm"])] for r in rows[30:]]) / 1e3
    assert np.abs(predicted - off[30:]).std() < 0.5 * off[30:].std()
