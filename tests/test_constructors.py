"""Constructors of what users state say which arguments are missing or unknown."""

from __future__ import annotations

import pydoc
from inspect import Parameter, isclass, signature

import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations
from factorgraph_adj.constructors import ChecksArguments
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import SlopeDistance

STATED = sorted(
    {
        c
        for module in (fga, observations)
        for name in module.__all__
        if isclass(c := getattr(module, name))
        and (
            issubclass(c, observations.Observation)
            or c in (fga.Point, fga.Camera, fga.Photo, fga.Parameter, fga.Correlated)
            or c in (fga.FaceReading, fga.TopocentricFrame, fga.SevenParameters)
            or c in (fga.IncrementalAdjustment, fga.Isam)
        )
    },
    key=lambda c: c.__name__,
)


def required(of: type) -> list[str]:
    """Return the names of the arguments that a constructor cannot do without."""
    every = list(signature(of.__init__).parameters.values())[1:]
    return [p.name for p in every if p.default is Parameter.empty]


@pytest.mark.parametrize("of", STATED)
def test_without_arguments_all_that_is_required_is_named(of: type) -> None:
    assert isinstance(of, ChecksArguments)
    if not (names := required(of)):
        return
    with pytest.raises(InputError) as raised:
        of()
    (problem,) = raised.value.problems
    assert problem.where == f"{of.__name__}()"
    assert problem.what.startswith(f"lacks {', '.join(names)}; required: ")


def test_there_are_constructors_to_look_at() -> None:
    assert len(STATED) > 50


def test_a_point_without_coordinates_is_told_by_its_name() -> None:
    with pytest.raises(InputError, match=r"^Point\('P'\): lacks coordinates; required: name, "):
        fga.Point("P")  # type: ignore[call-arg]


def test_everything_that_is_wrong_is_told_at_once() -> None:
    with pytest.raises(InputError) as raised:
        SlopeDistance("A", "B", 1.0, 2.0, station="C", sigmaa=0.1)  # type: ignore[call-arg, misc]
    told = [p.what.partition(";")[0] for p in raised.value.problems]
    assert told == [
        "unknown argument 'sigmaa'",
        "'station' is stated twice, with and without its name",
        "has 4 arguments without names, and takes 3: station, target, value",
        "lacks sigma",
    ]
    assert "did you mean 'sigma'?" in raised.value.problems[0].what


def test_an_error_of_the_code_of_a_constructor_stays_what_it_is() -> None:
    class Stated(metaclass=ChecksArguments):
        def __init__(self, name: str) -> None:
            raise TypeError(f"an error inside {name}")

    with pytest.raises(TypeError, match="an error inside P"):
        Stated("P")


def test_the_signature_of_a_class_is_that_of_its_constructor():
    shown = signature(fga.SlopeDistance).parameters
    own = signature(fga.SlopeDistance.__init__).parameters
    assert list(shown) == list(own)[1:]
    assert list(shown)[:3] == ["station", "target", "value"]
    assert shown["sigma"].kind is Parameter.KEYWORD_ONLY
    assert "*values" not in pydoc.plain(pydoc.render_doc(fga.SlopeDistance)).split("Method")[0]
