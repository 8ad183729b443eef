"""A wrong word is answered with the one that was meant: on the command line and from Python."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.simulation.spec import read_spec


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["adjst", "project"], "adjust"),
        (["adjust", "project", "--snop"], "--snoop"),
        (["adjust", "project", "--test", "barda"], "baarda"),
        (["stream", "project", "--policy", "flg"], "flag"),
    ],
)
def test_the_command_asks(words: list[str], meant: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert capsys.readouterr().err.rstrip().endswith(f"; did you mean {meant!r}?")


def yard() -> fga.Network:
    """Return two points with a measured distance."""
    network = fga.Network("a yard")
    network.add_point("Pillar1", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("Pillar2", (10.0, 0.0, 0.0), fixed="yz")
    network.add(SlopeDistance("Pillar1", "Pillar2", 10.0, sigma=0.001, id="first"))
    network.add(SlopeDistance("Pillar1", "Pillar2", 10.0, sigma=0.001, id="second"))
    return network


ASKED: dict[str, tuple[Callable[[fga.Solution], object], str]] = {
    "a point of a solution": (lambda s: s.point("pillar1"), "Pillar1"),
    "a point to leave out": (lambda s: fga.without(s.network, [], points=["Pilar2"]), "Pillar2"),
    "an observation to leave out": (lambda s: fga.without(s.network, ["frist"]), "first"),
    "an observation of a table": (lambda s: fga.reliability(s).row("secnd"), "second"),
    "an observation to predict": (lambda s: fga.predict(s, s.network, ids=["scond"]), "second"),
    "a column": (lambda s: s.point_table()["nme"], "name"),
    "a kind of unknowns": (lambda s: s.unknown("oriention", "x"), "orientation"),
    "a datum": (lambda s: fga.adjust(s.network, datum="fre"), "free"),  # type: ignore[call-overload]
    "a test": (lambda s: fga.snoop(s.network, test="barda"), "baarda"),  # type: ignore[arg-type]
    "an estimator": (
        lambda s: fga.snoop(s.network, robust="hubr"),  # type: ignore[arg-type]
        "huber",
    ),
    "groups": (lambda s: fga.estimate_variance_components(s.network, groups="kinds"), "kind"),
    "a policy": (
        lambda s: fga.IncrementalAdjustment(s.network, policy="rejct"),  # type: ignore[arg-type]
        "reject",
    ),
    "an id to take out": (lambda s: fga.IncrementalAdjustment(s.network).remove("fist"), "first"),
    "a key of a spec": (lambda s: read_spec("sed = 1"), "seed"),
}


@pytest.mark.parametrize("what", ASKED)
def test_python_asks(what: str) -> None:
    call, meant = ASKED[what]
    solution = fga.adjust(yard())
    with pytest.raises(fga.InputError) as found:
        call(solution)
    assert f"did you mean {meant!r}?" in str(found.value)


def test_units_are_not_asked_for() -> None:
    """``grad`` is like ``rad``, and means ``gon``."""
    with pytest.raises(fga.InputError) as found:
        fga.units.parse_angle("1", "grad")
    assert "did you mean" not in str(found.value)


def test_an_option_of_another_command_is_said_to_be_one(capsys):
    with pytest.raises(SystemExit):
        main(["compare", "a", "b", "--quiet"])
    said = capsys.readouterr().err
    assert "other commands have --quiet" in said and "did you mean" not in said
