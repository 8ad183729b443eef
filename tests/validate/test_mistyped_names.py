"""A typing error in a name makes a new point where an old one is; both names are told."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.orientation.choice_of_start import start_or_problems
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.validate.mistyped_names import mistyped_at_start
from tests.field_mistakes.projects import Project
from tests.field_mistakes.site import SETTINGS, book_as, site, star_net


def before(network: fga.Network) -> list[str]:
    """Return what the start values tell."""
    start, problems = start_or_problems(network)
    assert start is not None, problems
    return mistyped_at_start(network, start.state)


def after(network: fga.Network) -> list[str]:
    """Return what the adjustment tells."""
    return [d for d in Report(fga.adjust(network)).doubts if "mistyped" in d]


def corners() -> fga.Network:
    """Return three held points."""
    network = fga.Network("shaft")
    for name, x, y in (("A", 0.0, 0.0), ("B", 40.0, 0.0), ("C", 0.0, 30.0)):
        network.add_point(name, (x, y, 0.0), fixed="xyz")
    return network


def renamed(p: Project, name: str, other: str) -> Project:
    """Give a point another name, wherever it is used."""
    for rows in p.tables.values():
        for row in rows:
            for key in ("name", "station", "target"):
                if row.get(key) == name:
                    row[key] = other
    return p


@pytest.mark.parametrize(
    ("name", "typed"),
    [
        ("P1", "PI"),
        ("P1", "Pl"),
        ("P1", "p1"),
        ("P1", "P11"),
        ("P1", "P"),
        ("P10", "P1O"),
        ("S5", "SS"),
        ("K8", "KB"),
        ("102", "120"),
        ("102", "103"),
        ("Kirche", "Krche"),
        ("Kirche", "Kirhce"),
    ],
)
def test_a_mistyped_name_is_told_before_and_after_the_adjustment(name, typed, tmp_path) -> None:
    p = renamed(site(), "P1", name)
    book_as(p, "S2", name, typed)
    network = fga.read_project(p.write(tmp_path / "site"))
    for (doubt,) in (before(network), after(network)):
        assert f"point {typed!r} may be point {name!r}, mistyped" in doubt or (
            f"point {name!r} may be point {typed!r}, mistyped" in doubt
        )


@pytest.mark.parametrize("seed", range(12))
def test_similar_names_at_other_places_are_told_never(seed, tmp_path) -> None:
    # P1, P2, P3 differ by one character; so do these, of which each is observed once.
    p = site(seed)
    for name, at in (("P4", "P1"), ("P5", "P2"), ("PI", "P3")):
        old = {r["kind"]: r for r in p.tables["observations.csv"] if r["target"] == at}
        p.tables["points.csv"].append({"name": name})
        for kind, by in (("direction", 0.3), ("zenith_angle", 0.1), ("slope_distance", 0.2)):
            row = dict(old[kind]) | {"target": name}
            row["value"] = f"{float(row['value']) + by:.4f}"
            p.tables["observations.csv"].append(row)
    network = fga.read_project(p.write(tmp_path / "site"))
    assert before(network) == after(network) == []


def test_another_name_at_the_place_of_a_point_is_its_owners_choice(tmp_path) -> None:
    p = site()
    book_as(p, "S2", "P1", "nail")
    network = fga.read_project(p.write(tmp_path / "site"))
    assert before(network) == after(network) == []


def test_names_with_an_epoch_are_a_rule_of_naming(tmp_path) -> None:
    p = site()
    for name in ("P1", "P2", "P3"):
        book_as(p, "S2", name, f"{name}b")
    network = fga.read_project(p.write(tmp_path / "site"))
    assert before(network) == after(network) == []


def test_a_letter_for_each_round_is_a_rule_of_naming(tmp_path) -> None:
    p = site()
    for name, again in (("P1", "D1"), ("P2", "E2"), ("P3", "F3")):
        book_as(p, "S2", name, again)
    network = fga.read_project(p.write(tmp_path / "site"))
    assert before(network) == after(network) == []


def measured_from(network: fga.Network, *stations: str) -> fga.Network:
    """Observe A, B, C from stations that stand at (12, 9, 0)."""
    rng = np.random.default_rng(5)
    for station in stations:
        network.add_point(station, (12.0, 9.0, 0.0))
        for target in ("A", "B", "C"):
            to = np.array(network.points[target].coordinates) - (12.0, 9.0, 0.0)
            level = float(np.hypot(to[0], to[1]))
            azimuth = float(np.arctan2(to[0], to[1]))
            for kind, value, sigma in (
                (fga.Direction, azimuth, 1e-5),
                (fga.ZenithAngle, float(np.arctan2(level, to[2])), 1e-5),
                (fga.SlopeDistance, float(np.linalg.norm(to)), 0.001),
            ):
                read = value + sigma * float(rng.normal())
                network.add(kind(station, target, read, sigma=sigma))
    return network


def test_a_free_station_that_is_set_up_twice_has_two_names() -> None:
    network = corners()
    measured_from(network, "4903", "4904")
    assert after(network) == before(network) == []


def test_points_whose_places_are_shared_on_purpose_are_no_errors(tmp_path) -> None:
    p = site()
    for name, again in (("P1", "P11"), ("P2", "nail"), ("P3", "bolt")):
        book_as(p, "S2", name, again)
    network = fga.read_project(p.write(tmp_path / "site"))
    assert before(network) == after(network) == []


def test_marks_one_above_the_other_are_two_points_in_plan() -> None:
    network = corners()
    rng = np.random.default_rng(3)
    for name in ("P1u", "P1o"):
        network.add_point(name, (12.0, 9.0, 0.0), fixed="z")
        for at in ("A", "B"):
            start = np.array(network.points[at].coordinates)
            length = float(np.linalg.norm(start - (12.0, 9.0, 0.0))) + 0.002 * rng.normal()
            network.add(fga.HorizontalDistance(at, name, length, sigma=0.002))
    assert after(network) == before(network) == []


@pytest.mark.parametrize("command", ["check", "adjust"])
def test_the_command_names_a_new_point_of_a_star_net_file(command, tmp_path, capsys) -> None:
    p = site()
    settings = tmp_path / "site.toml"
    settings.write_text(SETTINGS, encoding="utf-8")
    for typed, code in (("P1", 0), ("PI", 1)):
        book_as(p, "S2", "P1", typed)
        file = tmp_path / f"{typed}.dat"
        file.write_text(star_net(p), encoding="utf-8")
        assert main([command, str(file), "--set", f"options={settings}"]) == code
        told = " ".join("".join(capsys.readouterr()).split())
        assert ("point 'PI' may be point 'P1', mistyped" in told) == (typed == "PI")


def kerb(names: tuple[str, str], at: np.ndarray) -> fga.Network:
    """Return a detail survey of one set-up with two points 5 cm apart, distances of 1 cm."""
    network = corners()
    for name, place in zip(names, (at, at + np.array([0.0, 0.05, 0.0])), strict=True):
        network.add_point(name, tuple(place.tolist()))
        length = float(np.linalg.norm(place))
        network.add(
            fga.Direction("A", name, float(np.arctan2(place[0], place[1])), sigma=3e-5),
            fga.ZenithAngle("A", name, float(np.arccos(place[2] / length)), sigma=3e-5),
            fga.SlopeDistance("A", name, length, sigma=0.01),
        )
    network.add(fga.Direction("A", "B", np.pi / 2, sigma=3e-5))
    return network


@pytest.mark.parametrize(("names", "n"), [(("T41", "T42"), 0), (("7", "17"), 0), (("P1", "PI"), 1)])
def test_two_points_of_a_set_up_may_have_numbers_in_a_row(names: tuple[str, str], n: int) -> None:
    network = kerb(names, np.array([0.0, 40.0, 1.0]))
    assert len(before(network)) == len(after(network)) == n
