"""``adjust --report``: the report as a file, beside the other files or alone."""

import pytest

from factorgraph_adj.cli.command_line import main
from tests.support.pages import data_of
from tests.support.places import EXAMPLES

BLOCK = str(EXAMPLES / "industry_block")


def test_a_report_is_written_with_the_options_of_the_run(tmp_path, capsys):
    file = tmp_path / "report.html"
    options = ["--quiet", "--ellipses", "0.9", "--date", "today", "--report", str(file)]
    assert main(["adjust", BLOCK, *options, "--language", "de"]) == 0
    said = capsys.readouterr()
    assert said.err == "" and said.out.startswith("no indication of gross errors; σ̂0 0.98680")
    assert said.out.count("\n") == 1
    text = file.read_text(encoding="utf-8")
    assert '<html lang="de">' in text and "today" in text and "--ellipses 0.9" in text
    assert data_of(text, "plan")["level"] == "90 %"
    files = data_of(text, "sheet-files")["columns"][0]
    assert any(f.endswith("project.toml") for f in files)


def test_a_report_and_the_tables_may_stand_together(tmp_path):
    options = ["--quiet", "--snoop", "--out", str(tmp_path), "--report", str(tmp_path / "r.html")]
    assert main(["adjust", BLOCK, *options]) == 0
    assert {"r.html", "report.txt", "points.csv"} <= {p.name for p in tmp_path.iterdir()}
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "Nothing had to be rejected." in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--language", "de"], "--language belongs to --report"),
        (["--report", "."], "--report must be a file, not a folder"),
        (["--report", "r.pdf"], "--report has no valid suffix; valid: .html"),
        (["--report", "r.html", "--parts", "2"], "--report is for a network that is adjusted as"),
    ],
)
def test_options_that_do_not_fit_are_refused_before_anything_is_read(options, words, capsys):
    assert main(["adjust", "nowhere.toml", *options]) == 2
    assert words in capsys.readouterr().err


def test_a_missing_extra_is_told_before_anything_is_read(monkeypatch, capsys):
    monkeypatch.setattr("factorgraph_adj.report.html.rendering.find_spec", lambda name: None)
    assert main(["adjust", "nowhere.toml", "--report", "r.html"]) == 2
    assert "pip install 'factorgraph_adj[report]'" in capsys.readouterr().err
