"""LGC2: what stands where, and what is refused with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.units import CC, GON

TEXT = """*TITR
a small network
*OLOC
*PREC 6
*INSTR
*POLAR T P1 0 0 0
P1 5 7 0.1 2 0 0 0 0
*SCALE R 0.2 0 0.01 0 0
*CALA
A 0 0 0
B 100 0 0
*VXY
C 50.0 80.0 1.0 % a comment
*POIN
D 20.0 30.0 2.0
*TSTN A T IHFIX
*V0
*ANGL
B 100.0
C 35.6
D 37.43
*ZEND
C 99.3
D 96.5
*DIST
C 94.345
D 36.111
*ECSP A B R
D 30.06
*END
"""


def read(folder: Path, text: str = TEXT, name: str = "net.lgc2") -> fga.Network:
    (folder / name).write_text(text, encoding="utf-8")
    return fga.read_lgc2(folder / name)


def test_points_and_observations_have_what_their_blocks_say(tmp_path: Path) -> None:
    network = read(tmp_path)
    assert [p.held for p in network.points.values()] == ["xyz", "xyz", "z", ""]
    kinds = [o.kind for o in network.observations.values()]
    assert kinds == ["direction"] * 3 + ["zenith_angle"] * 2 + ["slope_distance"] * 2 + [
        "line_offset"
    ]
    direction, zenith = network.observations["1"], network.observations["4"]
    assert (direction.value, direction.sigma) == pytest.approx((100 * GON, 5 * CC))  # type: ignore[attr-defined]
    assert zenith.sigma == pytest.approx(7 * CC)  # type: ignore[attr-defined]
    assert direction.source == "net.lgc2:19"  # type: ignore[attr-defined]
    offset = network.observations["8"]
    assert (offset.value, offset.sigma) == pytest.approx((30.07, 0.0002))  # type: ignore[attr-defined]
    assert fga.read(tmp_path / "net.lgc2").points.keys() == network.points.keys()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("*OLOC", "*RS2K", "net.lgc2:3: *RS2K: the grid of the geoid of 2000 is not here"),
        ("*ZEND", "*ZENT", "net.lgc2:22: *ZENT is not understood"),
        ("C 99.3", "C 99,3", "net.lgc2:23: the reading: '99,3' is not a number; write a"),
        ("C 99.3", "X 99.3", "net.lgc2:23: unknown point 'X'"),
        ("C 99.3", "C 99.3 OBSE 3", "net.lgc2:23: options 'OBSE 3' are not read"),
        ("*TSTN A T", "*TSTN A U", "unknown instrument 'U'; known: T, R"),
        ("*TSTN A T IHFIX", "*TSTN A T IHVAR", "with IHFIX, not 'IHVAR'"),
        ("R 0.2 0 0.01", "R 0.2 3 0.01", "ppm 3, centring 0; only zeros are read"),
        ("B 100 0 0", "A 100 0 0", "net.lgc2:11: point 'A' stands in line 10 already"),
        ("*POIN", "*FRAME F 0 0 0 0 0 0 1\n*POIN", "frame F has no *ENDFRAME"),
        ("*POIN", "*ENDFRAME\n*POIN", "*ENDFRAME ends no frame"),
        ("*VXY", "*FRAME F 0 0 0 0 0 0 1 TX\n*FRAME G 1 0 0 0 0 0 1 TX\n*POIN",
         "is free in the free frame F"),
        ("B 100.0\n", "B 100.0\nC 1e99\n", "net.lgc2:20: the reading must be at most 1e+12"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    if "FRAME G" in new:
        text = text.replace("*POIN\nD", "*ENDFRAME\n*ENDFRAME\n*POIN\nD")
    with pytest.raises(fga.InputError) as caught:
        read(tmp_path, text)
    assert message in str(caught.value)


def test_standard_deviations_of_coordinates_are_millimetres(tmp_path: Path) -> None:
    """LGC2's own tests call ``P1 -1 -1 -1 1 2 3`` an observation with 1 mm, 2 mm and 3 mm."""
    path = tmp_path / "coordinates.lgc2"
    path.write_text(
        "*TITR\ncoordinates\n*OLOC\n*INSTR\n*CALA\nA 0 0 0\n*FRAME F 0 0 0 0 0 100 1 TX TY TZ RZ\n"
        "*POIN\nP1 1 1 1\n*OBSXYZ\nP1 -1 -1 -1 1 2 3\n*ENDFRAME\n*END\n",
        encoding="ascii",
    )
    (o,) = [o for o in fga.read_lgc2(path).observations.values() if o.source == f"{path.name}:11"]
    assert o.value == (-1.0, -1.0, -1.0)
    assert np.sqrt(np.diag(o.covariance)) == pytest.approx([0.001, 0.002, 0.003])


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("*POLAR T P1 0 0 0", "*POLAR T P1 0 0.5 0"),
        ("P1 5 7 0.1 2 0 0 0 0", "P1 5 7 0.1 2 0.033 0 0 0"),
        ("P1 5 7 0.1 2 0 0 0 0", "P1 5 7 0.1 2 0 0 0 0.5"),
        ("*SCALE R 0.2 0 0.01 0 0", "*SCALE R 0.2 0 0.01 0.1 0"),
    ],
)
def test_corrections_and_centring_that_are_not_read_are_refused(
    before: str, after: str, tmp_path: Path
) -> None:
    assert before in TEXT
    path = tmp_path / "net.lgc2"
    path.write_text(TEXT.replace(before, after), encoding="ascii")
    with pytest.raises(InputError, match=r"net\.lgc2:\d+: .*not read|only zeros are read"):
        fga.read_lgc2(path)
