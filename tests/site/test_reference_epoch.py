"""The reference of a site is the stated epoch, or the first that is whole; which one is told."""

from __future__ import annotations

import pytest

from factorgraph_adj.site.reference_epoch import ReferenceEpoch, reference_epoch
from tests.support.sites import ADDRESS, readings, served, yard_site


def results(*of: tuple[int, int] | None) -> dict[int, dict]:
    """Results of epochs 1, 2, … with numbers of points and of readings; None: no estimate."""
    return {
        n: {"estimate": e and {"components": [0] * e[0], "n_observations": e[1]}}
        for n, e in enumerate(of, 1)
    }


@pytest.mark.parametrize(
    ("epochs", "stated", "expected"),
    [
        ((), None, None),
        ((None, None), None, None),
        (((3, 10),), None, ReferenceEpoch(1, "first")),
        (((3, 75), (3, 100)), None, ReferenceEpoch(1, "first")),
        (((3, 74), (3, 100)), None, ReferenceEpoch(2, "whole")),
        (((2, 100), (3, 100), (3, 100)), None, ReferenceEpoch(2, "whole")),
        (((2, 9), (3, 90), None, (3, 150), (3, 100)), None, ReferenceEpoch(4, "whole")),
        (((3, 100), (3, 10), (3, 100)), None, ReferenceEpoch(1, "first")),
        (((3, 10), (3, 100)), 1, ReferenceEpoch(1, "stated", poorer=True)),
        (((3, 10), (3, 100), (3, 100)), 2, ReferenceEpoch(2, "stated")),
        (((3, 10), None, (3, 100)), 2, ReferenceEpoch(3, "stated")),
        (((3, 10), (3, 10)), 3, None),
    ],
)
def test_the_reference_is_the_first_epoch_that_is_as_good_as_the_next(epochs, stated, expected):
    assert reference_epoch(results(*epochs), stated, timed=True) == expected


def test_an_epoch_that_somebody_ended_is_the_reference_and_its_poverty_is_told():
    poor = results((2, 10), (3, 100))
    assert reference_epoch(poor, None, timed=False) == ReferenceEpoch(1, "first", poorer=True)


def post(client, hour, part=range(8)):
    records = readings(hour)
    answers = client.post(f"{ADDRESS}/postings", json=[records[i] for i in part]).json()
    assert all(a["ok"] for a in answers), answers


HALF = (0, 3, 6, 7)
"""A difference, a distance and directions: C is determined, from half of the readings."""


@pytest.mark.parametrize("stated", [None, 1])
def test_an_epoch_that_began_within_its_time_is_no_reference_by_default(tmp_path, stated):
    folder = yard_site(tmp_path, epochs="1 h")
    if stated is not None:
        text = (folder / "site.toml").read_text()
        (folder / "site.toml").write_text(text + f"reference = {stated}\n")
    with served(tmp_path) as client:
        post(client, 0, HALF)
        for hour in range(1, 4):
            post(client, hour)

        def shown(number):
            epoch = client.get(f"{ADDRESS}/epochs/{number}").json()
            return epoch["reference"], [d["name"] for d in epoch["displacements"]]

        if stated is None:
            of = {"epoch": 2, "epochs": 1, "why": "whole", "poorer": False}
            assert shown(2) == (of, [])
        else:
            of = {"epoch": 1, "epochs": 1, "why": "stated", "poorer": True}
            assert shown(2) == (of, ["C"])
        assert shown(3) == (of, ["C"])


@pytest.mark.parametrize("stated", [None, 1])
def test_an_epoch_without_a_free_point_does_not_end_the_monitoring(tmp_path, stated):
    """Its estimate could not be read again, and no later epoch was compared, without a word."""
    folder = yard_site(tmp_path, epochs="1 h")
    if stated is not None:
        text = (folder / "site.toml").read_text()
        (folder / "site.toml").write_text(text + f"reference = {stated}\n")
    with served(tmp_path) as client:
        post(client, 0, (6,))  # a direction from A to B, which are given: an orientation alone
        for hour in range(1, 4):
            post(client, hour)
        epochs = [client.get(f"{ADDRESS}/epochs/{n}").json() for n in (1, 3)]
        assert "determines no point" in epochs[0]["problem"]
        assert epochs[1]["problem"] == "" and epochs[1]["reference"]["epoch"] == 2
        assert [d["name"] for d in epochs[1]["displacements"]] == ["C"]
