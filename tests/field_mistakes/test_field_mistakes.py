"""Every mistake is named by the command that is to find it, and changes its exit code."""

from __future__ import annotations

import pytest

from factorgraph_adj.cli.command_line import main

from . import site_mistakes  # noqa: F401  (registers its mistakes)
from .mistakes import (
    MISTAKES,
    POLES,
    Mistake,
    full_circle,
    in_pixels,
    polar_hall,
    yard_with_lake,
)
from .projects import Project, book_of_both, facade, field_book, hall, yard, yard_on_earth
from .site import site
from .trackers import rig, tracked_hall


def pixels() -> Project:
    """Return the wall in pixels, as it is."""
    return in_pixels(1500, y_axis='y_axis = "down"')


def poles() -> Project:
    """Return the yard with targets of several heights."""
    return yard(heights=POLES)


def told(text: str) -> str:
    """Return a text with single blanks for line ends and indents."""
    return " ".join(text.split())


LONG_ONES = {
    "the distances of a tracker in millimetres",  # a hundred iterations in each round of snooping
    "a tilted tracker, with data snooping",
    "the images of two members of a rig exchanged",
    "most readings of an instrument rejected",
    "the same, with data snooping",
    "two targets of a tracker exchanged that are far apart",
    "a target of a tracker read for another",
    "two targets exchanged, whose heights were looked up by name",
    "rotation matrices transposed",
    "two targets of a tracker exchanged",
    "two targets exchanged, with which the adjustment has no minimum",
}
LONG = pytest.mark.slow(
    "mistakes that take data snooping many rounds or many iterations; short tests take the others"
)


@pytest.mark.parametrize(
    "mistake",
    [pytest.param(m, marks=LONG if m.name in LONG_ONES else (), id=m.name) for m in MISTAKES],
)
def test_a_mistake_is_named(mistake: Mistake, tmp_path, capsys) -> None:
    folder = mistake.make().write(tmp_path / "yard")
    code = main([mistake.command[0], str(folder), *mistake.command[1:]])
    output = "".join(capsys.readouterr())
    assert told(mistake.line) in told(output)
    assert code == mistake.code


FAULTLESS = [yard, facade, field_book, hall, book_of_both, pixels, poles, yard_on_earth]
FAULTLESS += [polar_hall, yard_with_lake, full_circle, tracked_hall, rig, site]


@pytest.mark.parametrize("project", FAULTLESS)
@pytest.mark.parametrize("command", [("check",), ("adjust",), ("adjust", "--snoop")])
def test_without_a_mistake_nothing_is_told(command, project, tmp_path, capsys) -> None:
    assert main([command[0], str(project().write(tmp_path / "yard")), *command[1:]]) == 0
    output = "".join(capsys.readouterr()).lower()
    assert "doubt" not in output and "cause" not in output


def test_there_are_forty() -> None:
    assert {m.name for m in MISTAKES} >= LONG_ONES
    assert len(MISTAKES) >= 40
    assert len({m.name for m in MISTAKES}) == len(MISTAKES)
