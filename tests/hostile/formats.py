"""Undamaged files of every format that can be read, and what of them is declared as not read."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import factorgraph_adj as fga
from tests.field_mistakes.projects import facade, yard
from tests.hostile.sources import GAMA, bal
from tests.io.survey import field_files
from tests.networks import jag3d, photo_files, survey_files
from tests.networks.surveyed import surveyed

Files = dict[str, bytes]
MAPPING = """decimal = ","

[points]
file = "points.csv"
name = "Punkt"
x = "Rechts"
y = "Hoch"
z = "H"

[readings]
station = "=S"
target = "Ziel"
direction = "Hz"
zenith = "V"
distance = "S"
instrument_height = "=1.5"
target_height = "th"
"""
OPTIONS = ("fixed",)
"""Options of readers that problems may be about."""
HELD = {"fixed": "A,B,C", "refraction": None}


@dataclass(frozen=True)
class Format:
    """Files of one format."""

    reader: str
    """Name of the reader in the table of formats."""
    files: Callable[[Path], Files]
    """Contents by name, made in an empty folder."""
    begin: str = ""
    """File with which the reader begins; empty: the folder."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the reader."""
    beside: Mapping[str, str] = field(default_factory=dict)
    """Options that name another file, and its name."""

    def reads(self, path: Path) -> fga.Network:
        """Read the file with which the reader begins, or the folder."""
        folder = path.parent if self.begin else path
        other = {name: folder / file for name, file in self.beside.items()}
        return fga.read(path, format=self.reader, **self.options, **other)


def _texts(**texts: str) -> Callable[[Path], Files]:
    return lambda _: {name: text.encode() for name, text in texts.items()}


def _text(name: str, text: Callable[[], str] | str) -> Callable[[Path], Files]:
    return lambda _: {name: (text if isinstance(text, str) else text()).encode()}


def _jag3d_flat(folder: Path) -> Files:
    fga.write_jag3d(surveyed(), folder / "flat")
    return {f.name: f.read_bytes() for f in sorted((folder / "flat").iterdir())}


def _project(make: Callable[[], Any]) -> Callable[[Path], Files]:
    def files(folder: Path) -> Files:
        at = make().write(folder / "project")
        return {f.name: f.read_bytes() for f in sorted(at.iterdir()) if f.is_file()}

    return files


FORMATS: dict[str, Format] = {
    "project": Format("project", _project(yard)),
    "project with photos": Format("project", _project(facade)),
    "gama": Format("gama", _text("net.gkf", GAMA), "net.gkf"),
    "bal": Format("bal", lambda _: {"problem.txt": bal()}, "problem.txt"),
    "bal packed": Format("bal", lambda _: {"p.txt.bz2": bz2.compress(bal())}, "p.txt.bz2"),
    "colmap": Format("colmap", lambda _: photo_files.colmap()),
    "colmap binary": Format("colmap", photo_files.colmap_binary),
    "metashape": Format("metashape", photo_files.psz, "project.psz"),
    "metashape-xml": Format("metashape-xml", photo_files.metashape, "cameras.xml"),
    "opf": Format("opf", photo_files.opf, "block.opf"),
    "opensfm": Format("opensfm", lambda _: photo_files.opensfm(), "reconstruction.json"),
    "openmvg": Format(
        "openmvg",
        lambda _: photo_files.openmvg(),
        "sfm_data.json",
        {"positions": "observe"},
    ),
    "opencv": Format("opencv", lambda f: photo_files.opencv(".yml", f), "calibration.yml"),
    "opencv xml": Format("opencv", lambda f: photo_files.opencv(".xml", f), "calibration.xml"),
    "micmac": Format(
        "micmac",
        lambda _: photo_files.micmac(),
        "Orientation-0.tif.xml",
        beside={"control": "control.xml", "measures": "measures.xml"},
    ),
    "micmac of mmvii": Format(
        "micmac",
        lambda _: photo_files.mmvii(),
        "Ori-PerspCentral-0.tif.xml",
        beside={"control": "control.xml", "measures": "measures.xml"},
    ),
    "bundler": Format("bundler", _text("b.out", photo_files.BUNDLER), "b.out"),
    "dbat": Format("dbat", lambda _: photo_files.dbat(), "script.xml"),
    "aicon": Format("aicon", lambda _: photo_files.aicon(), "block.obc"),
    "star-net": Format(
        "star-net",
        _text("job.dat", survey_files.STAR_NET),
        "job.dat",
        {"options": survey_files.STAR_NET_OPTIONS},
    ),
    "gsi": Format("gsi", _text("book.gsi", field_files.gsi), "book.gsi", HELD),
    "gsi of levels": Format(
        "gsi", _text("levels.gsi", survey_files.LEVELS), "levels.gsi", {"fixed": "A"}
    ),
    "sdr33": Format("sdr33", _text("book.sdr", field_files.sdr33), "book.sdr", HELD),
    "jobxml": Format("jobxml", _text("book.jxl", field_files.jobxml), "book.jxl", HELD),
    "landxml": Format("landxml", _text("book.xml", field_files.landxml), "book.xml", HELD),
    "hexml": Format(
        "landxml",
        _text("book.hexml", lambda: field_files.landxml(hexml=True)),
        "book.hexml",
        HELD,
    ),
    "columns": Format(
        "columns",
        lambda _: {
            **{n: t.encode() for n, t in field_files.columns().items()},
            "mapping.toml": MAPPING.encode(),
        },
        "book.csv",
        HELD,
        {"mapping": "mapping.toml"},
    ),
    "sinex": Format("sinex", _text("small.snx", survey_files.SINEX), "small.snx"),
    "dynaml": Format("dynaml", lambda _: survey_files.dynaml(), "combined.xml"),
    "gvx": Format("gvx", survey_files.gvx, "n.gvx"),
    "comp3d": Format("comp3d", _texts(**survey_files.COMP3D), "net.obs", {"latitude": 48.8}),
    "mmvii": Format("mmvii", _texts(**survey_files.MMVII), "meas.obs"),
    "jag3d flat files": Format("jag3d", _jag3d_flat),
    "jag3d": Format("jag3d", _text("site.script", jag3d.script(jag3d.site())), "site.script"),
    "jag3d database": Format("jag3d", lambda _: jag3d.files(jag3d.site()), "site.script"),
    "jag3d flat": Format("jag3d", _texts(**jag3d.FLAT)),
    "lgc2": Format("lgc2", _text("net.lgc2", survey_files.LGC2), "net.lgc2"),
}
"""One set of files at least for each row of the table of formats."""
