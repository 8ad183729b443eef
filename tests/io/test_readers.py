"""One table tells which reader a file has; the command and `fga.read` use the same one."""

from __future__ import annotations

import bz2
import gzip
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.adjustment_options import AdjustOptions
from factorgraph_adj.io.field_books import gsi
from factorgraph_adj.io.field_books.accuracies import DEFAULT_ACCURACIES, Accuracies
from factorgraph_adj.io.field_books.field_book import FieldBook
from factorgraph_adj.io.field_books.field_records import (
    NEEDED,
    RecordField,
    Scales,
    read_angle,
    read_length,
    read_name,
    read_record,
)
from factorgraph_adj.io.format_reader import NetworkReader, Reader
from factorgraph_adj.io.photogrammetry import bundler
from factorgraph_adj.io.photogrammetry.bundler import read_bal
from factorgraph_adj.io.project import read_project
from factorgraph_adj.io.readers import READERS, Readers
from factorgraph_adj.io.source import TextSource
from factorgraph_adj.io.survey.gama import read_gama
from factorgraph_adj.io.text_files import file_beginning
from factorgraph_adj.network.network import Network
from factorgraph_adj.units import ANGLE, FOOT
from tests.networks.projects import OBSERVATIONS, write
from tests.support.places import data_dir
from tests.support.same import assert_same_network

BUNDLE = "problem-49-7776-pre-shrink-1800.txt"


def messages(caught: pytest.ExceptionInfo[InputError]) -> list[str]:
    return [str(p) for p in caught.value.problems]


# -- the formats ----------------------------------------------------------------------------------


def test_a_project_is_read_by_its_file_or_its_folder(tmp_path):
    path = write(tmp_path)
    expected = read_project(path)
    for given in (path, str(path), tmp_path, str(tmp_path)):
        assert_same_network(fga.read(given), expected)


def test_a_network_of_gama_is_read():
    path = data_dir("gama_3d_networks") / "local_3d.gkf"
    assert_same_network(fga.read(path), read_gama(path))


def test_a_bundle_is_read_plain_and_packed(tmp_path):
    path = data_dir("bal") / BUNDLE
    expected = read_bal(path)
    assert_same_network(fga.read(path), expected)
    text = path.read_bytes()
    files = {"a.txt.bz2": bz2.compress(text, 1), "a.b.txt.gz": gzip.compress(text, 1)}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        packed = fga.read(tmp_path / name)
        assert packed.name == expected.name.replace(BUNDLE, name)
        packed.name = expected.name
        assert_same_network(packed, expected)


def test_a_design_may_lack_readings_in_a_project_only(tmp_path):
    rows = [line.rsplit(",", 3) for line in OBSERVATIONS.splitlines()]
    design = "".join(f"{','.join([first, *rest[1:]])}\n" for first, *rest in rows)
    path = write(tmp_path, observations=design)
    assert "value" not in design
    with pytest.raises(InputError, match="value"):
        READERS.load(path)
    network = READERS.load(path, readings=False).network
    assert len(network.observations) == len(rows) - 1


def test_a_bare_network_has_default_units_and_options():
    path = data_dir("gama_3d_networks") / "local_3d.gkf"
    project = READERS.load(path)
    assert (project.path, project.options) == (path, AdjustOptions())


# -- what cannot be read --------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["list.xls", "toml", ".toml", "p.toml.old", "p.gz"])
def test_a_file_of_an_unknown_suffix_is_described(tmp_path, name):
    (tmp_path / name).write_text("x", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        fga.read(tmp_path / name)
    (said,) = messages(caught)
    assert said.startswith(f"{tmp_path / name}: is of no known kind: text that begins with 'x'; ")


def test_a_missing_file_is_refused_whatever_its_suffix(tmp_path):
    for name in ("nowhere", "nowhere.toml", "nowhere.gkf", "nowhere.txt"):
        with pytest.raises(InputError) as caught:
            fga.read(tmp_path / name)
        assert messages(caught) == [f"{tmp_path / name}: no such file or folder"]


# -- one more format ------------------------------------------------------------------------------


def read_heights(path: Path) -> Network:
    """Read a format of this test: one held point a line, name and height."""
    network = Network(path.stem)
    for line in path.read_text(encoding="utf-8").splitlines():
        name, height = line.split()
        network.add_point(name, (0.0, 0.0, float(height)), fixed="xyz")
    return network


HEIGHTS = Reader("heights", (".hgt", ".hgt.txt"), "list of heights", NetworkReader(read_heights))


def test_a_new_format_is_one_line_of_the_table(tmp_path):
    (tmp_path / "benchmarks.hgt").write_text("A 412.5\nB 398.25\n", encoding="utf-8")
    readers = Readers((*READERS.entries, HEIGHTS))
    network = readers.load(tmp_path / "benchmarks.hgt").network
    assert {n: p.coordinates[2] for n, p in network.points.items()} == {"A": 412.5, "B": 398.25}


RAW_RECORDS = {
    "PT": (
        RecordField("name", "point", read_name, default=NEEDED),
        *(RecordField(a, a, read_length, default=NEEDED) for a in ("east", "north", "up")),
    ),
    "ST": (
        RecordField("station", "station", read_name, default=NEEDED),
        RecordField("height", "height of the instrument", read_length, default=0.0),
    ),
    "OB": (
        RecordField("target", "target", read_name, default=NEEDED),
        RecordField("direction", "direction", read_angle),
        RecordField("zenith", "zenith reading", read_angle),
        RecordField("distance", "slope distance", read_length),
    ),
}


def read_raw(
    path: Path, *, fixed: str = "", accuracies: Accuracies = DEFAULT_ACCURACIES
) -> Network:
    """Read a raw format of this test, a field book in feet and degrees."""
    source = TextSource(path, code_page="cp1252")
    book = FieldBook(source, accuracies, fixed)
    use: dict[str, Callable[..., None]]
    use = {"PT": book.point, "ST": book.begin, "OB": book.sight}
    for line, text in source.filled():
        code, *words = text.split()
        fields = source.field(line, code, "record").choice(RAW_RECORDS)
        if fields is not None:
            scales = Scales(length=FOOT, angle=ANGLE["deg"])
            use[code](line, **read_record(fields, words, source, line, scales))
    return book.network()


def test_a_raw_format_is_a_table_of_records_and_is_registered(tmp_path, monkeypatch):
    monkeypatch.setattr(READERS, "entries", READERS.entries)  # put back at the end
    raw = Reader("raw", (".raw",), "field book in words", NetworkReader(read_raw))
    assert fga.register_reader(raw) is raw
    path = tmp_path / "site.raw"
    path.write_bytes(
        "PT A 0 0 10\nPT B\xf6 100 0 10\nST A 5\nOB B\xf6 90 90 1D2\n".encode("latin-1")
    )
    network = fga.read(path, fixed="A,B\xf6", refraction=None)
    values = {o.kind: o.value for o in network.observations.values()}
    assert values["slope_distance"] == 100 * FOOT
    assert values["direction"] == values["zenith_angle"] == 90 * ANGLE["deg"]
    assert network.remarks == [
        "2 lines are not UTF-8: read as if in Windows-1252; first in site.raw:2"
    ]
    path.write_text("PT A 0 0\nXY\nST\nOB B 9O\nST A 1 2\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        fga.read(path)
    assert messages(caught) == [
        "site.raw:1: up is missing; valid: a number",
        "site.raw:2: record 'XY' is unknown; valid: PT, ST, OB",
        "site.raw:3: station is missing; valid: a name",
        "site.raw:4: direction: '9O' is not a number",
        "site.raw:5: has 3 fields; valid: at most 2, station, height of the instrument",
    ]
    with pytest.raises(InputError, match="name raw: claimed by the reader of field book in words"):
        fga.register_reader(raw)


def test_modules_state_their_readers():
    """A module of a room of formats that states a reader is in the table without another edit."""
    stated = {
        value.name
        for name, module in sys.modules.items()
        if name.startswith("factorgraph_adj.io.")
        for value in vars(module).values()
        if isinstance(value, Reader)
    }
    assert {gsi.READER.name, bundler.READER.name, bundler.BAL_READER.name} <= stated
    assert stated == {r.name for r in READERS.entries}


def test_the_longest_suffix_decides(tmp_path):
    (tmp_path / "a.hgt.txt").write_text("A 412.5\n", encoding="utf-8")
    for entries in ((*READERS.entries, HEIGHTS), (HEIGHTS, *READERS.entries)):
        assert list(Readers(entries).load(tmp_path / "a.hgt.txt").network.points) == ["A"]


def test_a_folder_needs_a_reader_of_folders(tmp_path):
    with pytest.raises(InputError, match="is a folder that no reader knows"):
        Readers((HEIGHTS,)).load(tmp_path)


def recognised(word: bytes, name: str) -> Reader:
    """Return a reader of files .hgt that begin with a word."""
    return Reader(
        name,
        (".hgt",),
        f"heights of {name}",
        NetworkReader(read_heights),
        recognises=lambda path: file_beginning(path).startswith(word),
    )


def test_a_folder_around_what_can_be_read_says_what_to_name(tmp_path):
    """The folder of a COLMAP workspace, its folder sparse, and a file of the model."""
    for name in ("cameras", "images", "points3D"):
        path = tmp_path / "work" / "sparse" / "0" / f"{name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    model = tmp_path / "work" / "sparse" / "0"
    for outer in (tmp_path / "work", tmp_path / "work" / "sparse"):
        with pytest.raises(InputError) as caught:
            fga.read(outer)
        (said,) = messages(caught)
        assert said == f"{outer}: is a folder that no reader knows; valid: {model} (COLMAP)"
    (model / "cameras.bin").write_bytes(b"")
    with pytest.raises(InputError) as caught:
        fga.read(model / "cameras.bin")
    assert messages(caught) == [
        f"{model / 'cameras.bin'}: is a part of COLMAP: give its folder, {model}"
    ]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no reader knows; valid: a folder of project, COLMAP, "):
        fga.read(tmp_path / "empty")


def test_content_decides_between_formats_of_one_suffix(tmp_path):
    a, b = recognised(b"A", "a"), recognised(b"B", "b")
    path = tmp_path / "x.hgt"
    for text, expected in (("A 1", a), ("B 1", b), ("C 1", HEIGHTS)):
        path.write_text(text, encoding="utf-8")
        assert Readers((HEIGHTS, a, b)).of(path) is expected
    with pytest.raises(InputError, match="is not heights of a or heights of b: text that"):
        Readers((a, b)).of(path)
    path.write_text("A 1", encoding="utf-8")
    with pytest.raises(InputError, match=r"could be heights of a or heights of c; .* a, c$"):
        Readers((a, recognised(b"A", "c"))).of(path)
    assert list(Readers((a, b)).load(path, format="b").network.points) == ["A"]
    with pytest.raises(InputError, match="no format 'c' can be read; valid: a, b"):
        Readers((a, b)).load(path, format="c")


def test_options_of_a_reader_are_its_keyword_arguments(tmp_path):
    def read_scaled(path: Path, *, scale: float = 1.0) -> Network:
        network = read_heights(path)
        for name, point in network.points.items():
            network.points[name] = replace(point, coordinates=scale * np.array(point.coordinates))
        return network

    readers = Readers((Reader("scaled", (".hgt",), "heights", NetworkReader(read_scaled)),))
    path = tmp_path / "x.hgt"
    path.write_text("A 2.5", encoding="utf-8")
    network = readers.load(path, options={"scale": 4.0}).network
    assert network.points["A"].coordinates[2] == 10.0
    with pytest.raises(InputError, match=r"has no option 'scales'; valid: scale; did you mean"):
        readers.load(path, options={"scales": 4.0})


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (
            Reader("heights", (".hgt", ".csv"), "heights", HEIGHTS.load),
            [
                "reader of heights: suffix .csv: claimed by the reader of table with a mapping "
                "already"
            ],
        ),
        (
            Reader("heights", (".toml",), "heights", HEIGHTS.load, folders=True),
            [
                "reader of heights: suffix .toml: claimed by the reader of project already",
                "reader of heights: folders: claimed by the reader of project already",
            ],
        ),
        (
            Reader("heights", (".hgt", ".hgt"), "heights", HEIGHTS.load),
            ["reader of heights: suffix .hgt: claimed by the reader of heights already"],
        ),
        (
            Reader("heights", (), "heights", HEIGHTS.load),
            ["reader of heights: has no suffix; valid: at least one, such as .txt"],
        ),
        (
            Reader("heights", ("hgt",), "heights", HEIGHTS.load),
            ["reader of heights: suffix 'hgt' is none; valid: a dot and small letters, as in .txt"],
        ),
        (
            Reader("heights", (".HGT",), "heights", HEIGHTS.load),
            [
                "reader of heights: suffix '.HGT' is none; valid: a dot and small letters, as in "
                ".txt"
            ],
        ),
    ],
)
def test_a_wrong_registration_is_refused(wrong, expected):
    with pytest.raises(InputError) as caught:
        Readers((*READERS.entries, wrong))
    assert messages(caught) == expected
