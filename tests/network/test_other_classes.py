"""Functions of a network or a solution refuse another object and say where a right one is from."""

import inspect
from pathlib import Path
from typing import Any

import pytest

import factorgraph_adj as fga

CLASSES = ("Network", "Solution", "Congruence", "Reliability", "ExportedResult")


def functions() -> list[str]:
    """Return the public functions whose first argument is a network or a result."""
    out = []
    for name in fga.__all__:
        function = getattr(fga, name)
        if not inspect.isfunction(function):
            continue
        first = next(iter(inspect.signature(function).parameters.values()), None)
        if first is not None and str(first.annotation).split(" | ")[0] in CLASSES:
            out.append(name)
    return out


def called(name: str, value: object) -> None:
    """Call a function with an object, and a path for whatever else it needs."""
    function: Any = getattr(fga, name)
    needed = [
        p
        for p in inspect.signature(function).parameters.values()
        if p.default is p.empty and p.kind is p.POSITIONAL_OR_KEYWORD
    ]
    function(value, *["x.json"] * (len(needed) - 1))


def test_there_are_many():
    names = functions()
    assert {"adjust", "snoop", "reliability", "plan", "preliminary", "write_report"} <= {*names}
    assert {"text_report", "write", "causes", "congruence", "write_star_net"} <= {*names}


@pytest.mark.parametrize("value", ["project.toml", Path("project.toml"), None, 3.0])
@pytest.mark.parametrize("name", functions())
def test_refused(name, value):
    with pytest.raises(fga.InputError, match=rf"^{name} takes a .*, not .*: give fga\.") as error:
        called(name, value)
    if isinstance(value, str | Path):
        assert "not 'project.toml'" in str(error.value)


def test_path_of_a_project():
    with pytest.raises(fga.InputError) as error:
        fga.adjust("project.toml")  # type: ignore[call-overload]
    assert str(error.value) == (
        "adjust takes a Network, not 'project.toml': give fga.read('project.toml')"
    )
    with pytest.raises(fga.InputError, match=r"fga\.read_project"):
        fga.IncrementalAdjustment("p")  # type: ignore[arg-type]


def test_network_for_a_solution():
    with pytest.raises(fga.InputError) as error:
        fga.reliability(fga.Network("n"))  # type: ignore[arg-type]
    assert str(error.value) == (
        "reliability takes a Solution, not an object of Network: give fga.adjust(network)"
    )


def test_by_name():
    with pytest.raises(fga.InputError, match="snoop takes a Network, not 'p'"):
        fga.snoop(network="p")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="network"):
        fga.snoop()  # type: ignore[call-arg]
