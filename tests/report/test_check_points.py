"""Check points in reports: axes, survey error, number that the standards ask for."""

from __future__ import annotations

from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.html.page import adjustment_html
from factorgraph_adj.report.options import ReportOptions
from factorgraph_adj.report.text import render_text


def network(frame: fga.LocalFrame | fga.TopocentricFrame | None = None) -> fga.Network:
    """Return two observed points 3 cm east and 4 cm above the truth."""
    out = fga.Network("checked", frame=frame)
    for i in range(2):
        at = (10.0 * i, 5.0, 2.0)
        out.add_point(f"C{i}", at, check=(at[0] - 0.03, at[1], at[2] - 0.04))
        out.add(fga.ControlPoint(f"C{i}", at, sigma=(0.01, 0.01, 0.01)))
    return out


def text(survey: float | tuple[float, float] | None = None, **options: object) -> str:
    solution = fga.adjust(network(**options))
    return " ".join(render_text(Report(solution, ReportOptions(survey=survey))).split())


def test_reports_say_what_the_standards_ask_for() -> None:
    said = text()
    assert "RMSE_H 30.0, RMSE_V 40.0 mm (ASPRS edition 2; add the survey error" in said
    assert "2 check points are fewer than the 30 of ASPRS edition 2." in said
    assert "2 check points are fewer than the 20 of NSSDA." in said
    assert "more than half" not in said


def test_survey_errors_count_in_quadrature() -> None:
    """√(30² + 40²) and √(40² + 9²) mm: the first is more than half of the whole."""
    said = text((0.04, 0.009))
    assert "RMSE_H 50.0, RMSE_V 41.0 mm (ASPRS edition 2; with survey errors of the check" in said
    assert "The horizontal survey error of the check points, 40.0 mm, is more than half" in said
    assert "The vertical survey error" not in said


def test_the_axes_of_differences_are_named() -> None:
    assert "dx, dy, dz are along the axes of the frame." in text()
    frame = fga.TopocentricFrame(0.8, 0.2, 400.0, "WGS84")
    assert "dx, dy, dz are along east, north and up at the origin" in text(frame=frame)


@pytest.mark.parametrize(
    ("language", "words"), [("en", "fewer than the 30"), ("de", "verlangt 30")]
)
def test_pages_have_the_same_in_both_languages(language: str, words: str) -> None:
    report = Report(fga.adjust(network()), ReportOptions(survey=(0.04, 0.009)))
    page = adjustment_html(report, language=language)
    assert words in page and "RMSE_H 50.0, RMSE_V 41.0 mm" in page


def test_the_command_takes_the_survey_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fga.write_project(network(), tmp_path / "p")
    main(["adjust", str(tmp_path / "p"), "--full", "--check-sigma", "0.04,0.009"])
    assert "RMSE_H 50.0, RMSE_V 41.0 mm" in " ".join(capsys.readouterr().out.split())
    for wrong in ("0.01,0.02,0.03", "-1", "x", "inf"):
        with pytest.raises(SystemExit):
            main(["adjust", str(tmp_path / "p"), f"--check-sigma={wrong}"])
        assert "horizontal and vertical σ, such as 0.01,0.02" in capsys.readouterr().err
