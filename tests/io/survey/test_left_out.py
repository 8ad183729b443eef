"""Every row, point and observation that a reader of surveys leaves out is counted and named."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from tests.hostile.sources import GAMA
from tests.io.field_books import field_files
from tests.networks import jag3d, survey_files


@dataclass(frozen=True)
class Damage:
    """A file of a format in which a row is switched off, and what the network says of it."""

    files: Callable[[], dict[str, str]]
    """The files; the first is read."""
    file: str
    """Name of the file in which a text is replaced."""
    old: str
    new: str
    said: str
    """Sentence of the network."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Options of the reader."""


OFF = "points and observations: {} left out, as they are switched off in the file: {}; first in {}"
LOW: dict[str, object] = {"options": {**survey_files.STAR_NET_OPTIONS, "adjustment": "2D"}}


def one(name: str, text: str | Callable[[], str]) -> Callable[[], dict[str, str]]:
    """Return a single file."""
    return lambda: {name: text if isinstance(text, str) else text()}


def jag3d_site(table: str, where: dict[str, object]) -> Callable[[], dict[str, str]]:
    """Return a project of JAG3D in which rows are switched off."""

    def files() -> dict[str, str]:
        rows = jag3d.site()
        jag3d.column(rows, table, "enable", False, where)
        return {"site.script": jag3d.script(rows)}

    return files


DAMAGES = {
    "Gama": Damage(
        one("net.gkf", GAMA), "net.gkf", '<obs from="P">',
        '<point id="Q" x="1" y="2"/><obs from="P">',
        "points: 1 left out, as the file neither fixes nor adjusts them: Q; first in net.gkf:10",
    ),
    "LandXML, an observation": Damage(
        one("s.xml", field_files.landxml), "s.xml", "<RawObservation",
        '<RawObservation status="deleted"', OFF.format(1, "S A", "s.xml:10"),
    ),
    "LandXML, a group": Damage(
        one("s.xml", field_files.landxml), "s.xml", '<ObservationGroup id="o"',
        '<ObservationGroup id="x" setupID="s1" status="deleted"><RawObservation>'
        '<TargetPoint name="Z"/></RawObservation></ObservationGroup><ObservationGroup id="o"',
        OFF.format(1, "S Z", "s.xml:9"),
    ),
    "LandXML, a point": Damage(
        one("s.xml", field_files.landxml), "s.xml", "</CgPoints>",
        '<CgPoint name="Q" status="deleted">1 2 3</CgPoint></CgPoints>',
        OFF.format(1, "Q", "s.xml:8"),
    ),
    "JobXML, a sight": Damage(
        one("s.jxl", field_files.jobxml), "s.jxl", "<Name>A</Name><Deleted>true",
        "<Name>A</Name><Deleted>true", OFF.format(1, "A", "s.jxl:"),
    ),
    "JobXML, GNSS": Damage(
        one("s.jxl", field_files.jobxml), "s.jxl", "</FieldBook>",
        "<PointRecord><Name>G</Name><ECEFDeltas><DeltaX>1</DeltaX></ECEFDeltas></PointRecord>"
        "</FieldBook>",
        "points of GNSS: 1 left out, as sights of total stations alone are read: G; first in s.jxl",
    ),
    "SDR33": Damage(
        one("s.sdr", field_files.sdr33), "s.sdr", "03NM", "09MCS\n03NM",
        "reduced observations: 1 left out, as they are derived: raw readings alone are read: MC; "
        "first in s.sdr:",
    ),
    "SDR33, deleted": Damage(
        one("s.sdr", field_files.sdr33), "s.sdr", "03NM", "DDF1S\n03NM",
        OFF.format(1, "DDF1S", "s.sdr:"),
    ),
    "STAR*NET, .DATA OFF": Damage(
        one("s.dat", survey_files.STAR_NET), "s.dat", "D A-P", ".DATA OFF\nD A-P",
        "lines: 4 left out, as they stand behind .DATA OFF: D A-P, L A-P, V B-P, B A-P; "
        "first in s.dat:13",
        {"options": survey_files.STAR_NET_OPTIONS},
    ),
    "STAR*NET, a value": Damage(
        one("s.dat", survey_files.STAR_NET), "s.dat", "59.1234 180.278", "? 180.278",
        "values: 1 left out, as the file has ? in their place: angle A-B-P; first in s.dat:10",
        {"options": survey_files.STAR_NET_OPTIONS},
    ),
    "STAR*NET, heights of a 2D project": Damage(
        one("s.dat", "C A 0 0 ! !\nC B 0 100 ! !\nC P 50 50\nD A-P 70.71\nD B-P 70.71\n"), "s.dat",
        "D B-P", "L A-P 1.0 0.1\nD B-P",
        "observations: 1 left out, as a 2D project has no heights: A-P; first in s.dat:5", LOW,
    ),
    "DynaML, a measurement": Damage(
        lambda: {k: v.decode() for k, v in survey_files.dynaml().items()}, "combined.xml",
        "<Type>S</Type><Ignore/>", "<Type>S</Type><Ignore>*</Ignore>",
        OFF.format(1, "S A C", "combined.xml:"),
    ),
    "DynaML, a direction": Damage(
        lambda: {k: v.decode() for k, v in survey_files.dynaml().items()}, "combined.xml",
        "<Directions><Ignore/><Target>B", "<Directions><Ignore>*</Ignore><Target>B",
        OFF.format(1, "D C B", "combined.xml:"),
    ),
    "SINEX": Damage(
        one("s.snx", survey_files.SINEX), "s.snx", "TROTOT", "TROTOT",
        "parameters: 1 left out, as coordinates of stations alone are read: TROTOT; "
        "first in s.snx:8",
    ),
    "Comp3D, a point": Damage(
        lambda: {"net.obs": "", **survey_files.COMP3D}, "net.obs", "4 S2 F1", "4 S2 OUT",
        OFF.format(3, "-1 OUT, 4 S2 OUT, T1 20.0 0.0", "net.cor:6"), {"latitude": 48.8},
    ),
    "Comp3D, an observation": Damage(
        lambda: {"net.obs": "", **survey_files.COMP3D}, "net.obs", "3 S1 T1 50.0400 0.001",
        "3 S1 T1 50.0400 -0.001",
        OFF.format(3, "-1 OUT, 3 S1 T1, T1 20.0 0.0", "net.cor:6"), {"latitude": 48.8},
    ),
    "Comp3D, a code": Damage(
        lambda: {"net.obs": "", **survey_files.COMP3D}, "net.obs", "6 S1 T1", "-6 S1 T1",
        OFF.format(3, "-1 OUT, -6 S1 T1, T1 20.0 0.0", "net.cor:6"), {"latitude": 48.8},
    ),
    "MMVII": Damage(
        lambda: {"meas.obs": "", **survey_files.MMVII}, "meas.obs", "3 B C", "3 B C",
        OFF.format(1, "3 B C", "meas.obs:6"),
    ),
    "JAG3D, a point": Damage(
        jag3d_site("PointApriori", {"name": "N1"}), "site.script", "", "",
        OFF.format(9, "N1, P N1, A N1, B N1, A B, C N1", "site.script:"),
    ),
    "JAG3D, an observation": Damage(
        jag3d_site("ObservationApriori", {"id": 0}), "site.script", "", "",
        OFF.format(3, "P A, A B, C N1", "site.script:"),
    ),
    "JAG3D, an epoch": Damage(
        lambda: {"site.script": jag3d.script(jag3d.two_epochs())}, "site.script", "", "",
        "left out, as they belong to the other epoch: epoch=… chooses: ", {"epoch": "control"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", DAMAGES)
def test_what_is_left_out_is_counted_and_named(what: str, tmp_path: Path) -> None:
    damage = DAMAGES[what]
    files = damage.files()
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    path = tmp_path / damage.file
    text = path.read_text(encoding="utf-8")
    assert damage.old in text
    path.write_text(text.replace(damage.old, damage.new, 1), encoding="utf-8")
    network = fga.read(tmp_path / next(iter(files)), **damage.options)  # type: ignore[arg-type]
    said = [str(left) for left in network.left_out]
    assert any(damage.said in s for s in said), said
    assert not any(left.doubtful for left in network.left_out)


UNDAMAGED = {
    "Gama": one("net.gkf", GAMA),
    "LandXML": one("s.xml", field_files.landxml),
    "SDR33": one("s.sdr", field_files.sdr33),
    "GSI": one("s.gsi", field_files.gsi),
    "DynaML": lambda: {k: v.decode() for k, v in survey_files.dynaml().items()},
    "LGC2": one("s.lgc2", survey_files.LGC2),
}


@pytest.mark.parametrize("what", UNDAMAGED)
def test_a_file_of_which_all_is_used_says_nothing(what: str, tmp_path: Path) -> None:
    files = UNDAMAGED[what]()
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    assert fga.read(tmp_path / next(iter(files))).left_out == []


REFUSED: dict[str, tuple[Any, ...]] = {
    "GSI": (
        one("s.gsi", field_files.gsi), "s.gsi", "21.322", "29.322", "word '29' is unknown", {},
    ),
    "GSI, a level": (
        one("s.gsi", survey_files.LEVELS), "s.gsi",
        "110004+0000000B 32...8+02100000 332.08+00120000\n", "",
        "ends with an incomplete set-up", {},
    ),
    "LGC2": (
        one("s.lgc2", survey_files.LGC2), "s.lgc2", "*ZEND", "*ZENX", "*ZENX is not understood", {},
    ),
    "columns": (
        field_files.columns, "points.csv", "A;", ";", "a point without a name", {},
    ),
    "GVX": (
        None, "session.gvx", "<TERMINAL_POINT_ID>", "<TERMINAL_POINT_ID>x", "unknown point ID", {},
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_formats_without_switches_refuse_rows_that_they_cannot_use(
    what: str, tmp_path: Path
) -> None:
    make, file, old, new, said, options = REFUSED[what]
    if make is None:
        files = {k: v.decode() for k, v in survey_files.gvx(tmp_path).items()}
        file = next(k for k, v in files.items() if old in v)
    else:
        files = make()
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    path = tmp_path / file
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    if what == "columns":
        options = {"mapping": field_files.MAPPING}
        path = tmp_path / next(iter(files))
    with pytest.raises(InputError, match=said.replace("*", r"\*")):
        fga.read(path, **options)
