"""A point whose rays become parallel waits again, and everything else goes on.

Two photos stand side by side; a point is so far away that its two rays meet somewhere only until
the right photo turns by a little more. The batch adjustment of all of it has no minimum and says
so by name.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.incremental.entry import Entry
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.simulation.measurement import measure
from tests.support.arrivals import bare, batch, difference

SHIFT = 0.006
"""mm by which the later control points are read too far right: 6 σ, the far point's parallax."""
RAYS = ("left/far", "right/far")


def block(sigma: tuple[float, float, float] | None = None) -> fga.Network:
    """Return two photos 0.1 m apart, 16 control points in the right one, and two points.

    Args:
        sigma: standard deviations of the far point's given coordinates.
    """
    network = fga.Network("side by side")
    network.add_camera("camera", BrownLens(), {"c": 50.0})
    down = np.diag([1.0, -1.0, -1.0])
    network.add_photo("left", "camera", position=(0, 0, 20), rotation=down, fixed=True)
    network.add_photo("right", "camera", position=(0.1, 0, 20), rotation=down)
    rng = np.random.default_rng(3)
    for i in range(16):
        at = (*rng.uniform(-6, 6, 2), rng.uniform(-3, 3))
        network.add_point(f"G{i}", at, fixed="xyz")
        network.add(ImagePoint("right", f"G{i}", 0, 0, sigma=0.001))
    for name, at in {"far": (1, 2, -780), "near": (1, -2, 0.5)}.items():
        network.add_point(name, at, sigma=sigma if name == "far" else None)
        network.add(*(ImagePoint(f, name, 0, 0, sigma=0.001) for f in ("left", "right")))
    return measure(network, seed=1, noise=False)


def arriving(
    journal: Path | None = None, sigma: tuple[float, float, float] | None = None
) -> tuple[fga.IncrementalAdjustment, list[ImagePoint]]:
    """Return the block with half of the control, and the other half, shifted."""
    network = block(sigma)
    readings = {o.point: o for o in network.image_points() if o.photo == "right"}
    later = [replace(o, x=o.x + SHIFT) for n, o in readings.items() if n in LATER]
    inc = fga.IncrementalAdjustment(bare(network), policy="accept", journal=journal)
    inc.add([o for o in network.image_points() if o.point not in LATER])
    assert len(inc) == 12 and not inc.n_waiting
    return inc, later


LATER = [f"G{i}" for i in range(8, 16)]


def test_it_waits_and_everything_else_goes_on() -> None:
    """The arrival says what waits again; the rest equals the batch adjustment at any time."""
    inc, later = arriving()
    sigma = np.sqrt(np.diag(inc.covariance("near")))
    waits: list[str] = []
    for reading in later:
        arrival = inc.add(reading)
        waits += arrival.waits
        assert [v.verdict for v in arrival.verdicts] == ["accepted"]
        found = difference(inc.solution(), batch(inc))
        assert max(found.estimates, found.sigmas) < 1e-2
    assert waits == list(RAYS), "once, and nothing else"
    assert [w.id for w in inc.waiting] == list(RAYS)
    assert all("far" in w.label for w in inc.waiting)
    with pytest.raises(fga.InputError, match="'far'"):
        inc.estimate("far")
    inc.settle()
    found = difference(inc.solution(), batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-6
    assert (np.sqrt(np.diag(inc.covariance("near"))) < sigma).all()


def test_the_batch_of_all_names_it() -> None:
    """There is no minimum with it."""
    inc, later = arriving()
    network = inc.network()
    network.add(*later)
    with pytest.raises(fga.DatumError, match="'far'") as caught:
        fga.adjust(network)
    assert caught.value.unknowns == (("point", "far"),)


@pytest.mark.slow(
    "what arrives ends where the batch adjustment does, in every order and network; short "
    "tests take a few"
)
@pytest.mark.parametrize("between", ["nothing", "settle", "resume"])
def test_it_enters_again_when_what_drove_it_out_is_gone(tmp_path: Path, between: str) -> None:
    """And is where it was."""
    journal = tmp_path / "day.jsonl"
    inc, later = arriving(journal)
    before = inc.estimate("far")
    ids = [v.id for o in later for v in inc.add(o).verdicts]
    assert inc.n_waiting == 2
    if between == "settle":
        inc.settle()
        assert inc.n_waiting == 2, "there is no minimum with it"
    elif between == "resume":
        del inc
        inc = fga.IncrementalAdjustment.resume(journal)
    inc.remove(ids)
    assert not inc.n_waiting
    inc.settle()
    sigma = np.sqrt(np.diag(inc.covariance("far")))
    assert np.max(np.abs(inc.estimate("far") - before) / sigma) < 1e-2


def test_a_ray_from_elsewhere_brings_it_back() -> None:
    """Three rays determine it, whatever the first two do."""
    inc, later = arriving()
    inc.add(later)
    assert inc.n_waiting == 2
    scratch = fga.Network("further right")
    scratch.add_camera("camera", BrownLens(), {"c": 50.0})
    down = np.diag([1.0, -1.0, -1.0])
    scratch.add_photo("third", "camera", position=(80, 0, 20), rotation=down, fixed=True)
    at = 50.0 * np.array([1 - 80, 2]) / 800.0
    arrival = inc.add(ImagePoint("third", "far", *at, sigma=0.001), photos=scratch.photos.values())
    assert {v.verdict for v in arrival.verdicts} == {"accepted"}
    assert not inc.n_waiting
    found = difference(inc.solution(), batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-2


def test_a_weighted_point_is_not_let_go() -> None:
    """Its weight is an observation too; readings go on arriving."""
    inc, later = arriving(sigma=(np.inf, 0.01, np.inf))
    for reading in later:
        (verdict,) = inc.add(reading).verdicts
        assert verdict.verdict == "accepted"
    assert not inc.n_waiting


def test_nothing_is_lost_when_it_is_interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C in the middle: everything is as it was before the reading."""
    inc, later = arriving()
    n, at = len(inc), inc.estimate("far")

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Entry, "_let_go", interrupted)
    with pytest.raises(KeyboardInterrupt):
        inc.add(later)
    monkeypatch.undo()
    assert len(inc) == n and not inc.n_waiting
    sigma = np.sqrt(np.diag(inc.covariance("far")))
    assert np.max(np.abs(inc.estimate("far") - at) / sigma) < 1e-2
    inc.add(later)
    assert [w.id for w in inc.waiting] == list(RAYS)


def test_readings_that_came_with_it_are_told_once() -> None:
    """What enters together may let go a part of itself."""
    network = block()
    readings = [o for o in network.image_points() if o.point not in LATER]
    shifted = [o for o in network.image_points() if o.point in LATER]
    shifted = [replace(o, x=o.x + SHIFT) for o in shifted]
    inc = fga.IncrementalAdjustment(bare(network), policy="accept")
    inc.add([o for o in readings if o.point != "far"])
    rays = [o for o in readings if o.point == "far"]
    arrival = inc.add([*rays, *shifted])
    told = {v.id: v.verdict for v in arrival.verdicts}
    assert len(arrival.verdicts) == len(told) == 10
    assert {i for i, v in told.items() if v == "waiting"} == set(RAYS)
    assert not arrival.waits, "they were given"


def test_the_reason_says_what_happened() -> None:
    """Until it is looked at again with more beside it."""
    inc, later = arriving()
    while not inc.n_waiting:
        inc.add(later.pop(0))
    assert {w.lacks for w in inc.waiting} == {
        "its rays are parallel by now: there is no minimum at a finite distance"
    }


def test_its_own_last_reading_waits_too() -> None:
    """What arrives may itself be a ray of it."""
    inc, later = arriving()
    inc.remove("right/far")
    inc.add(later)
    (ray,) = (o for o in block().image_points() if (o.photo, o.point) == ("right", "far"))
    (verdict,) = inc.add(ray).verdicts
    assert verdict.verdict == "waiting"
    assert inc.solution().converged
    assert inc.n_waiting == 2


def test_a_journal_brings_it_back_waiting(tmp_path: Path) -> None:
    """The line of the arrival says what left with it."""
    journal = tmp_path / "day.jsonl"
    inc, later = arriving(journal)
    inc.add(later[0])
    inc.add(later[1])
    n, at = len(inc), inc.estimate("near")
    assert inc.n_waiting == 2
    del inc
    again = fga.IncrementalAdjustment.resume(journal)
    assert len(again) == n
    assert sorted(w.id for w in again.waiting) == sorted(RAYS)
    assert np.allclose(again.estimate("near"), at, atol=1e-4)
