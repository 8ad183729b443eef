"""Results show themselves in one line, and in HTML with a head line and their first rows."""

from __future__ import annotations

from html.parser import HTMLParser

import pytest

import factorgraph_adj as fga
from factorgraph_adj.experiment.runs import run
from factorgraph_adj.experiment.study import Experiment
from factorgraph_adj.planning.targets import SemiAxis
from factorgraph_adj.result_display import FIRST, Rows, Shown, html
from tests.networks.small_block import small_block


def trial(seed: int, count: int) -> dict[str, float]:
    return {"error": float(seed % 7 + count)}


@pytest.fixture(scope="module")
def results() -> dict[str, Shown]:
    network = small_block()
    solution = fga.adjust(network)
    found = fga.snoop(network)
    runs = run(Experiment("counts", trial, {"count": (1, 2)}), 4)
    some = list(network.observations)[:3]
    return {
        "Network": network,
        "Solution": solution,
        "Reliability": fga.reliability(solution),
        "Snooping": found,
        "VarianceComponents": fga.estimate_variance_components(network),
        "Significance": fga.significance(solution),
        "Exclusion": fga.exclude_insignificant(network),
        "Robust": fga.robust_adjust(network),
        "CheckPoints": fga.check_points(solution),
        "Prediction": fga.predict(fga.adjust(fga.without(network, some)), network),
        "Plan": fga.plan(network, SemiAxis(1e-6)),
        "Spared": fga.find_sparable(network, SemiAxis(1.0)),
        "Results": runs,
        "Summary": runs.summary(),
    }


class Seen(HTMLParser):
    """What a page has: tags in the order in which they open, all of them closed again."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)
        self.tags.append(tag)
        assert not attrs

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
def test_every_result_is_one_short_line_and_pure_html(results: dict[str, Shown]) -> None:
    for name, result in results.items():
        line = repr(result)
        assert line.startswith(f"<{name}"), line
        assert "\n" not in line
        assert len(line) < 250
        tags = Seen(result._repr_html_()).tags
        assert set(tags) <= {"div", "p", "b", "table", "thead", "tbody", "tr", "th", "td"}
        rows = result.first_rows()
        shown = 0 if rows is None else min(rows.total, FIRST)
        assert tags.count("tr") == (shown + 1 if shown else 0), name


def test_the_rows_of_a_solution_are_its_points() -> None:
    page = fga.adjust(small_block())._repr_html_()
    first = next(iter(small_block().points))
    assert f"<td>{first}</td>" in page
    assert f"the first {FIRST} of {len(small_block().points)} rows" in page


def test_text_is_escaped_and_rows_are_asked_for_only_as_far_as_they_are_shown() -> None:
    asked = []

    def cells():
        for i in range(1000):
            asked.append(i)
            yield f"<script>{i}</script>", 1.0 / 3.0

    page = html("a < b", Rows(("name", "value"), cells(), 1000))
    assert "a &lt; b" in page
    assert "<script>" not in page
    assert "<td>0.333333</td>" in page
    assert len(asked) == FIRST
    assert "the first 10 of 1000 rows" in page
