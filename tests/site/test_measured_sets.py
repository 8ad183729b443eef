"""Sets of instruments: those of an outage enter late, impossible ones do not."""

from __future__ import annotations

from itertools import islice

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.instruments.simulated_total_station import (
    SimulatedObject,
    SimulatedTotalStation,
)
from factorgraph_adj.network.network import Network
from factorgraph_adj.site.measured_sets import MeasuredSet
from tests.support.sites import ADDRESS, BEGIN, served, site_of, until, yard_of

STATION = """
[[instrument]]
name = "ts1"
network = "yard"
source = "file:ts1.gsi"
grammar = "gsi-online"
station = "A"
instrument_height = 0.0
targets = ["B", "C"]
clock = "stated"
[instrument.accuracies]
sigma_direction_mgon = 1.0
sigma_zenith_mgon = 1.0
sigma_distance_mm = 2.0
"""


def lines_of_sets(begin: float, number: int, seed: int = 0) -> list[str]:
    """Lines of sets of a simulated total station, one text for each set."""
    network = Network("yard", frame=LocalFrame(), datum="given")
    for name, xyz in {"A": (0, 0, 100), "B": (80, 0, 101), "C": (50, 30, 101.5)}.items():
        network.add_point(name, tuple(float(v) for v in xyz))
    of = SimulatedTotalStation(
        SimulatedObject(network), "A", ("B", "C"), begin=begin, sight_time=60.0, seed=seed
    )
    texts = [line.text.decode() + "\r\n" for line in islice(of.lines(), 4 * number)]
    return ["".join(texts[i : i + 4]) for i in range(0, len(texts), 4)]


def test_sets_of_an_outage_enter_late_and_those_of_a_simulation_begun_again_do_not(tmp_path):
    """Also where the service begins again: the sets of an instrument are in the database."""
    sets = lines_of_sets(BEGIN, 12)
    file = tmp_path / "ts1.gsi"
    file.write_text("".join(sets[:2] + sets[4:]), newline="")

    def counted(client):
        health = client.get("/api/v1/instruments").json()[0]
        epochs = {e["number"]: e for e in client.get(f"{ADDRESS}/epochs").json()}
        first = epochs.get(1, {"state": "", "counts": None, "revision": 0})
        number = first["counts"]["observations"] if first["counts"] else 0
        return health, number, first

    options = {"epochs": "1 h", "more": STATION}
    with served(tmp_path, **options) as client:
        before = until(lambda: counted(client)[0]["postings"] == 10 and counted(client)[1], 60.0)
        with file.open("a", newline="") as stream:
            stream.write("".join(sets[2:4]))
        until(lambda: counted(client)[1] == before / 4 * 6, 60.0)
    again = lines_of_sets(BEGIN + 100.0, 5, seed=1)
    with served(tmp_path, **options) as client:
        with file.open("a", newline="") as stream:
            stream.write("".join(again))
        until(lambda: counted(client)[0]["refused_postings"] == 5, 60.0)
        health, number, epoch = counted(client)
        assert "cannot have measured a set from" in health["problem"]
        assert (number, epoch["revision"]) == (before / 4 * 6, 2)


@pytest.mark.parametrize(
    ("second", "excluded"),
    [
        (("ts1", 0.0, 100.0, 1), True),  # the same times, of another simulation
        (("ts1", 0.0, 100.0, 2), False),  # the next round of the same pass
        (("ts1", 99.0, 200.0, 1), True),
        (("ts1", 40.0, 60.0, 1), True),
        (("ts1", 100.0, 200.0, 1), False),
        (("ts2", 0.0, 100.0, 1), False),
    ],
)
def test_an_instrument_measures_one_pass_at_a_time(second, excluded):
    first = MeasuredSet("ts1", 0.0, 100.0, 1)
    assert first.excludes(MeasuredSet(*second)) == excluded
    assert MeasuredSet(*second).excludes(first) == excluded


@pytest.mark.parametrize(
    "wrong",
    [
        {"begin": 0.0, "end": 1.0},
        {"instrument": "ts1", "begin": 2.0, "end": 1.0},
        {"instrument": "ts1", "begin": 0.0, "end": "1h"},
        {"instrument": "ts1", "begin": 0.0, "end": 1.0, "round": 0},
        {"instrument": "ts1", "begin": 0.0, "end": float("nan")},
        {"instrument": "ts1", "begin": 0.0, "end": 1.0, "rounds": 1},
        ["ts1", 0.0, 1.0],
    ],
)
def test_what_a_posting_says_of_its_set_is_checked(wrong):
    with pytest.raises(InputError, match="must be an object with instrument"):
        MeasuredSet.of({"measured": wrong})


def test_sets_that_wait_together_exclude_each_other(tmp_path):
    """Each posting is answered by itself, and the one that was refused may be right elsewhere."""
    reading = {"kind": "height_difference", "station": "A", "target": "B", "value": 1.0}
    given = [
        {**reading, "measured": {"instrument": "level", "begin": BEGIN + b, "end": BEGIN + e}}
        for b, e in ((0.0, 60.0), (30.0, 90.0), (60.0, 120.0))
    ]
    with site_of(tmp_path) as site:
        live = yard_of(site)
        with live.reading():
            futures = [live.submit(r) for r in given]
        answers = [f.result(30) for f in futures]
        assert [a["ok"] for a in answers] == [True, False, True]
        assert "level cannot have measured a set" in answers[1]["error"][0]["what"]
