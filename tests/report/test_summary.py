"""One screen of a result: verdict, worst readings, weakest points; one line; data frames."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.observations import HeadingDifference
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.catalogue import Texts
from factorgraph_adj.report.html.verdict import adjustment_verdict
from factorgraph_adj.report.layout import _width as width
from factorgraph_adj.report.options import Provenance, ReportOptions
from factorgraph_adj.report.results_json import results_record
from factorgraph_adj.report.summary import MAX_LINES, WORDS, render_summary, verdict_line
from factorgraph_adj.report.text import global_test_text
from factorgraph_adj.report.unknowns import unknown_components
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.statistical_tests import global_test
from tests.networks.odometry import odometry
from tests.support.places import EXAMPLES

N_POINTS = 6
SIGMA = 0.002


def trilateration(
    *, seed: int = 4, blunder: float = 0.0, prefix: str = "", held: int = 2
) -> fga.Network:
    """Return all distances between points in a plane, the first of them with a gross error."""
    rng = np.random.default_rng(seed)
    network = fga.Network(prefix or "field")
    angle = 2.0 * np.pi * np.arange(N_POINTS) / N_POINTS
    places = 100.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    names = [f"{prefix}{i}" for i in range(N_POINTS)]
    for i, (name, (x, y)) in enumerate(zip(names, places, strict=True)):
        network.add_point(name, (x, y, 0.0), fixed="xyz" if i < held else "z")
    for i in range(N_POINTS):
        for j in range(max(i + 1, held), N_POINTS):
            length = float(np.hypot(*(places[i] - places[j]))) + rng.normal(0.0, SIGMA)
            network.add(
                fga.HorizontalDistance(names[i], names[j], length, sigma=SIGMA, id=f"{i}-{j}")
            )
    if blunder:
        first = network.observations["0-2"]
        network.observations["0-2"] = replace(first, value=first.value + blunder)
    return network


def verdict(text: str) -> str:
    """Return the lines between the title and σ̂0 as one line."""
    return " ".join(text.partition("\n")[2].partition("  σ̂0  ")[0].split())


def test_a_good_network_has_the_verdict_of_the_page_and_the_figures_of_the_solution() -> None:
    solution = fga.adjust(trilateration())
    text = solution.summary()
    assert verdict(text) == "no indication of gross errors"
    assert f"σ̂0           {solution.sigma0:.5f}, the standard deviation of unit weight" in text
    assert f"{solution.redundancy} degrees of freedom" in text
    assert f"{solution.n_observations} observations, {solution.n_unknowns} unknowns" in text


def test_a_gross_error_has_the_doubts_of_the_report_and_its_reading_stands_first() -> None:
    solution = fga.adjust(trilateration(blunder=0.05))
    text, report = solution.summary(), fga.text_report(solution)
    first = [line for line in report.splitlines() if line.startswith("  DOUBTFUL RESULT: ")]
    assert first and first[0] in text.splitlines()
    rel = fga.reliability(solution)
    row = rel.row("0-2")
    listed = text.partition("  reading ")[2].splitlines()[1]
    assert "0 2 (id 0-2)" in listed
    shown = [f"{rel.w[row]:.2f}", "*", f"{rel.redundancy_numbers[row]:.2f}"]
    assert listed.split()[-7:-4] == shown
    assert float(listed.split()[-4]) == pytest.approx(1000.0 * rel.mdb[row], rel=0.005)
    assert float(listed.split()[-2]) == pytest.approx(1000.0 * rel.estimated_errors[row], rel=0.005)
    words = " ".join(text.split())
    above = int(np.sum(np.abs(rel.w) > rel.critical_w))
    assert above > 1
    assert f"of {above} marked *, only the test of the first is reliable" in words
    assert "--snoop" in words
    assert "estimated error of the reading (observed − true; w: adjusted − observed)" in words
    assert rel.w[row] * rel.estimated_errors[row] < 0 < rel.estimated_errors[row]


def test_a_star_that_chance_explains_is_said_to_be_one() -> None:
    """One test value of 1 027 good ones is above the critical value of one in a thousand."""
    network = fga.read_project(EXAMPLES / "industry_block")
    ident = "98"
    wrong = network.observations[ident]
    network.observations[ident] = replace(wrong, value=wrong.value - 0.0007)
    solution = fga.adjust(network)
    rel = fga.reliability(solution)
    assert np.sum(np.abs(rel.w) > rel.critical_w) == 1
    text = " ".join(solution.summary().split())
    assert verdict(solution.summary()) == "no indication of gross errors"
    expected = round(rel.alpha * np.sum(rel.controlled))
    assert f"of {rel.controlled.sum()} good readings, chance puts about {expected} above" in text
    assert "only the test of the first is reliable" not in text


def test_the_weakest_points_have_the_largest_standard_deviations() -> None:
    solution = fga.adjust(trilateration())
    table = solution.summary().partition("  point ")[2].splitlines()[1:-1]
    sigma = {n: np.linalg.norm(solution.standard_deviations(n)) for n in solution.network.points}
    free = [n for n in sorted(sigma, key=lambda n: -sigma[n]) if sigma[n] > 0]
    assert [line.split()[0] for line in table] == free


@pytest.mark.parametrize("blunder", [0.0, 0.05, 300.0])
@pytest.mark.parametrize(
    "prefix", ["", "a point with a name of more than a hundred characters " * 2]
)
def test_it_is_a_screen_whatever_the_names_and_doubts(blunder: float, prefix: str) -> None:
    network = trilateration(blunder=blunder, prefix=prefix)
    found = fga.snoop(network)
    for report in (
        Report(fga.adjust(network)),
        Report(fga.adjust(trilateration(blunder=blunder, prefix=prefix, held=0), datum="free")),
        Report(fga.adjust(network, max_iterations=1)),
        Report(found.solution, provenance=Provenance(found, network)),
    ):
        lines = render_summary(report).splitlines()
        assert len(lines) <= MAX_LINES
        assert max(map(width, lines)) <= 100
        assert lines[-1].startswith("all of it: --full")
        assert any(line.startswith("  reading ") for line in lines)
        assert any(line.startswith("  point ") for line in lines)


def test_a_free_network_says_its_datum_defect_and_holds_no_point() -> None:
    solution = fga.adjust(trilateration(held=0), datum="free")
    text = solution.summary()
    assert f"{solution.n_unknowns} unknowns, datum defect 3" in text
    assert f"{solution.redundancy} degrees of freedom" in text
    assert len(text.partition("  point ")[2].splitlines()) == 2 + 5


def test_symbols_are_explained_before_their_figures() -> None:
    text = " ".join(fga.adjust(trilateration()).summary().split())
    for symbol, meaning in (("w", "test value"), ("r", "redundancy number"), ("∇", "smallest")):
        assert text.index(f"{symbol}: {meaning}") < text.index("reading w")


def test_what_was_set_aside_is_named() -> None:
    network = trilateration(blunder=0.05)
    found = fga.snoop(network)
    text = render_summary(Report(found.solution, provenance=Provenance(found, network)))
    gone = found.rejected[0]
    size, sigma = (f"{1000.0 * x:.3g}" for x in (gone.final_error, gone.final_sigma))
    name = "  rejected     1 observation: horizontal distance 0 2 (id 0-2)"
    assert f"{name}, error {float(size):.1f} ± {sigma} mm" in text
    assert gone.final_error == pytest.approx(0.05, abs=4.0 * gone.final_sigma)
    lights = adjustment_verdict(
        Report(found.solution, provenance=Provenance(found, network)), WORDS
    )
    told = next(x.sentence for x in lights.lights if x.title == "Data snooping")
    assert told == found.reason[0].upper() + found.reason[1:] != found.reason
    assert found.headline().startswith("Snooping: 1 observation rejected, 0 unresolved")


def test_of_many_rejected_the_first_have_their_errors_and_the_others_their_names() -> None:
    network = trilateration()
    wrong = ["0-2", "0-3", "1-4", "2-5", "3-4", "1-5"]
    for k, ident in enumerate(wrong):
        reading = network.observations[ident]
        network.observations[ident] = replace(reading, value=reading.value + 0.5 + 0.3 * k)
    aside = fga.snoop(network).rejected
    found = replace(fga.snoop(network), rejected=aside + aside)
    assert len(aside) >= 3
    report = Report(found.solution, provenance=Provenance(found, network))
    lines = render_summary(report).splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("  rejected "))
    n = len(found.rejected)
    assert lines[at].startswith(f"  rejected     {n} observations: ")
    assert all(", error " in line for line in lines[at : at + 4])
    fifth = found.rejected[4]
    assert lines[at + 4].startswith(f"               and {n - 4} more: horizontal distance ")
    assert f"(id {fifth.id})" in lines[at + 4]
    assert lines[at + 5] == ""
    assert len(lines) <= MAX_LINES


def test_texts_of_a_screen_do_not_end_with_an_end_of_line() -> None:
    network = trilateration(blunder=0.05)
    for text in (fga.adjust(network).summary(), fga.snoop(network).summary()):
        assert text == text.rstrip()


def test_without_redundancy_it_says_so() -> None:
    network = fga.Network("two")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (1.0, 0.0, 0.0), fixed="xy")
    network.add(fga.HeightDifference("A", "B", 1.0, sigma=0.001))
    solution = fga.adjust(network)
    assert "no redundancy: no observation checks another" in solution.summary()
    assert verdict_line(Report(solution)).count("\n") == 1


@pytest.mark.parametrize("blunder", [0.0, 0.05])
def test_the_line_and_the_screen_agree_with_the_exit_code(blunder, tmp_path, capsys) -> None:
    fga.write_project(trilateration(blunder=blunder), tmp_path / "project.toml")
    code = main(["adjust", str(tmp_path), "--quiet"])
    line = capsys.readouterr().out
    assert line.count("\n") == 1
    assert code == line.startswith("doubtful result; σ̂0 ") == bool(blunder)
    assert main(["adjust", str(tmp_path)]) == code
    assert ("DOUBTFUL RESULT: " in capsys.readouterr().out) == bool(code)
    assert main(["adjust", str(tmp_path), "--full"]) == code
    assert "Adjusted coordinates" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["adjust", str(tmp_path), "--full", "--quiet"])


def test_data_frames_have_the_tables_of_the_solution() -> None:
    pandas = pytest.importorskip("pandas")
    solution = fga.adjust(trilateration())
    found = solution.to_pandas()
    assert list(found) == ["points", "photos", "unknowns", "observations"]
    for name, table in (
        ("points", solution.point_table()),
        ("photos", solution.photo_table()),
        ("unknowns", solution.unknown_table()),
        ("observations", fga.reliability(solution).table()),
    ):
        pandas.testing.assert_frame_equal(found[name], table.to_pandas())
    assert {"residual", "r", "w", "mdb"} <= set(found["observations"])
    assert len(found["observations"]) == solution.n_observations
    assert found["observations"]["r"].sum() == pytest.approx(solution.redundancy)


def test_without_pandas_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = fga.adjust(trilateration())
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(fga.InputError, match=r"needs pandas: pip install"):
        solution.to_pandas()


def test_the_screen_and_the_report_of_snooping_have_what_was_set_aside() -> None:
    found = fga.snoop(trilateration(blunder=0.05))
    assert found.rejected
    for text in (found.summary(), fga.text_report(found)):
        assert "rejected" in text
        assert "0-2" in text
    assert len(found.summary().splitlines()) <= MAX_LINES


@pytest.mark.parametrize("language", ["en", "de"])
def test_readings_better_than_stated_are_called_so_everywhere_and_nothing_is_rejected(
    tmp_path, language, capsys
) -> None:
    """σ ten times too large: no word of a rejection on screen, in text, page and one line."""
    network = trilateration()
    for i, o in network.observations.items():
        network.observations[i] = replace(o, sigma=10.0 * SIGMA)
    report = Report(fga.adjust(network))
    assert report.solution.sigma0 < 0.2
    screen, text = render_summary(report), fga.text_report(report.solution)
    words = "no indication of gross errors; the readings are better than their σ say"
    assert verdict(screen).startswith(words)
    assert verdict(screen).count("this is no sign of a gross error") == 1
    for told in (screen, text):
        assert "readings better than stated: χ²" in told
        assert "REJECTED" not in told and "Rejected" not in told and "reservation" not in told
    assert verdict_line(report).startswith(f"{words}; σ̂0 0.")
    found = adjustment_verdict(report, Texts(language))
    assert found.text == Texts(language)("verdict_too_good")
    (light,) = [x for x in found.lights if x.colour == "amber"]
    assert light.noted
    assert ("Verworfen" not in light.text) and ("Rejected" not in light.text)
    test = results_record(report)["global_test"]
    assert (test["accepted"], test["outcome"]) == (False, "too_small")
    fga.write_project(network, tmp_path / "p" / "project.toml")
    assert main(["adjust", str(tmp_path / "p"), "--quiet"]) == 0
    assert capsys.readouterr().out.startswith(words)


def test_a_second_reservation_beside_readings_that_are_too_good_is_kept_as_such() -> None:
    network = trilateration()
    for i, o in network.observations.items():
        network.observations[i] = replace(o, sigma=10.0 * SIGMA)
    network.add_point("alone", (300.0, 0.0, 0.0), fixed="z")
    network.add(fga.CoordinateDifference("0", "alone", (200.0, 0.0), axes="xy", sigma=SIGMA))
    said = verdict(fga.adjust(network).summary())
    assert said.startswith("the result stands, with reservations")
    assert "the readings fit better than their σ say" in said


@pytest.mark.parametrize(
    ("scale", "outcome", "words"),
    [
        (1.0, "accepted", "accepted"),
        (0.1, "too_large", "REJECTED"),
        (10.0, "too_small", "readings"),
    ],
)
def test_the_outcome_of_the_global_test_is_the_word_of_all_reports(scale, outcome, words) -> None:
    network = trilateration()
    for i, o in network.observations.items():
        network.observations[i] = replace(o, sigma=scale * SIGMA)
    solution = fga.adjust(network)
    test = global_test(solution)
    assert test.outcome == outcome
    assert global_test_text(test).startswith(words)
    assert test.accepted == (outcome == "accepted")
    assert test.too_good == (outcome == "too_small")


def test_the_weakest_poses_of_a_network_without_points_are_on_the_screen() -> None:
    solution = fga.adjust(measure(odometry(8), seed=3))
    text = render_summary(Report(solution))
    lines = text[text.index("Weakest poses") :].splitlines()
    assert lines[1].split()[:7] == ["photo", "σX0", "[mm]", "σY0", "[mm]", "σZ0", "[mm]"]
    assert lines[1].endswith("σ rotation [mgon]")
    size = {f: np.linalg.norm(solution.pose(f).sigmas[3:]) for f in solution.network.photos}
    worst = max(size, key=lambda f: size[f])
    name, *figures = lines[2].split()
    assert name == worst
    expected = 1000.0 * solution.pose(worst).sigmas[3:]
    assert np.array(figures[:3], float) == pytest.approx(expected, rel=0.05)


def test_headings_are_in_the_unit_of_directions() -> None:
    """An angle of the whole circle has the unit of observed angles, its σ too."""
    network = fga.Network("drive")
    for name, x in (("0", 0.0), ("1", 1.0)):
        network.add_point(name, (0.0, x, 0.0), fixed="xyz")
        network.set_unknown("heading", name, (0.0,), fixed=name == "0")
    for turn in (0.49, 0.51):
        network.add(HeadingDifference("0", "1", turn, sigma=0.01))
    for unit, size in (("deg", 180.0 / np.pi), ("gon", 200.0 / np.pi)):
        report = Report(fga.adjust(network), ReportOptions(units=Units(angle=unit)))
        (found,) = (u for u in unknown_components(report) if (u.kind, u.name) == ("heading", "1"))
        assert found.unit_name == unit
        assert found.value / found.unit.size == pytest.approx(0.5 * size)
