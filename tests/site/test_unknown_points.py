"""Names and patterns of a site file that match nothing are told at the start and by `check`."""

from __future__ import annotations

import pytest

from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.site.site_file import read_site
from factorgraph_adj.site.unknown_points import unknown_points
from tests.support.sites import ADDRESS, served, yard_site

MORE = """
[[instrument]]
name = "ts1"
network = "yard"
source = "file:ts1.gsi"
grammar = "gsi-online"
station = "A"
targets = ["B", "Q"]
rename = { "7" = "C" }
[[alarm]]
name = "wall"
points = ["C", "W*"]
false_alarms_per_month = 0.1
[[alarm]]
name = "pillars"
points = ["A"]
false_alarms_per_month = 0.1
"""
TOLD = [
    "site.toml: instrument 'ts1': targets: no point 'Q'; there are A, B, C",
    "site.toml: alarm 'wall': points: no point 'W*'; there are A, B, C",
    "site.toml: alarm 'pillars': points: A may not move, as the objects of the network are C: "
    "the rule tests nothing",
]


def test_what_matches_nothing_is_named(tmp_path):
    settings = read_site(yard_site(tmp_path, more=MORE))
    assert {str(p) for p in unknown_points(settings, {"yard": ["A", "B", "C"]})} == {*TOLD}
    assert {p.where for p in unknown_points(settings, {"yard": ["A", "B"]})} >= {
        "site.toml: network 'yard': objects",
        "site.toml: instrument 'ts1': rename",
    }


def test_it_is_told_when_a_site_begins_and_points_that_came_later_count(tmp_path):
    with served(tmp_path, more=MORE) as client:
        events = client.app.state.site.events.after(0)
        assert {e.data["what"] for e in events if e.kind == "problem"} == {*TOLD}
        added = {"do": "add", "points": [{"name": "W1", "x": 1.0, "y": 2.0, "z": 3.0}]}
        assert client.post(f"{ADDRESS}/postings", json=added).json()["ok"]
        assert len(client.app.state.site.unknown_points()) == len(TOLD) - 1


@pytest.mark.parametrize("right", [True, False])
def test_check_takes_a_site(tmp_path, capsys, right):
    folder = yard_site(tmp_path, more="" if right else MORE)
    code = main(["check", str(folder)])
    said = capsys.readouterr().out
    assert "yard" in said
    lines = (folder / "site.toml").read_text().split("\n")
    for text, key in zip(TOLD[:2], ("targets", 'points = ["C", "W'), strict=True):
        line = next((n for n, x in enumerate(lines, 1) if x.startswith(key)), 0)
        assert (text.replace("toml:", f"toml:{line}:") in said) != right, (text, said)
    if not right:
        assert code == 1


def test_check_tells_patterns_and_mistakes_at_once(tmp_path, capsys):
    """Also those of tables beside one that has a mistake."""
    wrong = MORE.replace('name = "pillars"', 'name = "pillars"\ntest = "motoin"')
    folder = yard_site(tmp_path, more=wrong + "[retention]\njournal = 3\n")
    assert main(["check", str(folder)]) == 2
    printed = capsys.readouterr()
    assert "motoin" in printed.err and "journal" in printed.err
    assert "no point 'Q'" in printed.out and "no point 'W*'" in printed.out
    with pytest.raises(InputError, match="motoin"):
        read_site(folder)


def test_check_tells_what_is_wrong_in_a_site_file(tmp_path, capsys):
    folder = yard_site(tmp_path, more="[retention]\njournal = 3\n")
    assert main(["check", str(folder / "site.toml")]) == 2
    printed = capsys.readouterr()
    assert "journal" in printed.out + printed.err
