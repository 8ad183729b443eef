"""A file is recognised by its content, whatever its name; an unknown one is told what it is."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.file_signatures import SIGNATURES, description
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.io.text_files import MAX_RECOGNITION_BYTES
from factorgraph_adj.io.writers import WRITERS
from tests.hostile.formats import FORMATS
from tests.support.places import data_dir

RECOGNISED = {
    name: form
    for name, form in FORMATS.items()
    if form.begin and READERS.named(form.reader).recognises is not None
}


@pytest.mark.parametrize("name", sorted(RECOGNISED))
def test_one_reader_recognises_each_example_and_its_suffix_does_not_matter(tmp_path, name):
    """JAG3D and MicMac recognise their files by names, which a copy with another suffix lacks."""
    form = RECOGNISED[name]
    path = form.write(tmp_path)
    sure = [r.name for r in READERS.entries if r.recognises is not None and r.recognises(path)]
    fitting = [r.name for r in READERS.suffix_readers(path)]
    assert form.reader in sure
    assert [n for n in sure if n in fitting] == [form.reader] or sure == [form.reader]
    assert READERS.of(path).name == form.reader


def said_of(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        fga.read(path)
    (problem,) = caught.value.problems
    assert problem.where == str(path)
    return problem.what


def test_a_file_under_another_suffix_is_read_and_the_network_says_so(tmp_path):
    source = data_dir("gama_3d_networks") / "local_3d.gkf"
    path = tmp_path / "network.txt"
    shutil.copy(source, path)
    network = fga.read(path)
    assert network.remarks == ["network.txt was read as GNU Gama, by its content"]
    assert len(network.observations) == len(fga.read(source).observations)
    assert not fga.read(source).remarks


@pytest.mark.parametrize(
    ("name", "content", "looks", "advice"),
    [
        ("a.dxf", b"999\nmade by hand\n  0\r\nSECTION\r\n  2\r\nHEADER\r\n", "DXF", "field book"),
        ("a.txt", b"%PDF-1.7\n%\xe2\xe3", "a PDF document", "printed from"),
        ("a.dat", b"\xff\xd8\xff\xe1\x00\x10Exif", "a photo in JPEG", "COLMAP"),
        ("a.las", b"LASF\x00\x00", "LAS or LAZ", "table of targets"),
        ("a.24o", b" " * 60 + b"RINEX VERSION / TYPE\n", "RINEX", "SINEX, GVX or DynaML"),
        ("a.csv", b"<!DOCTYPE html>\n<html>", "a page of HTML", "printed from"),
        ("a.T02", b"\x01\x02", "a raw log of Trimble GNSS", "SINEX, GVX or DynaML"),
        (
            "a.obs",
            b"MOVE3 V4.2.1 OBS file\r\n$\r\nNet\r\n$\r\nANGLEUNIT GON\r\n",
            "MOVE3",
            "guess-columns",
        ),
        (
            "a.txt",
            b"! levels\n_DATUM; NAD 83; 6378137; 298.25\n_UNITS; U; D\n",
            "Columbus",
            "guess-columns",
        ),
        ("a.dc", b"00NMSC V10-70       102105-Jan-26 12:20 111111\r\n", "(DC)", "JobXML"),
        ("a.sdr", b"00NMSC V7-50\r\n10NMJOB\r\n", "Trimble Survey Controller", "or M5"),
        (
            "a.xml",
            b'<?xml version="1.0"?>\n<gama-local-adjustment>',
            "results of GNU Gama",
            "input",
        ),
    ],
)
def test_a_file_of_another_sort_is_named_whatever_its_suffix(
    tmp_path, name, content, looks, advice
):
    path = tmp_path / name
    path.write_bytes(content)
    said = said_of(path)
    assert said.startswith("looks like ")
    assert looks in said
    assert advice in said


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.xyz", b"", "is of no known kind: an empty file"),
        ("a.xyz", b" \n\n", "is of no known kind: a file of blanks"),
        ("a.xyz", b"a\0b", "is of no known kind: binary; "),
        ("a.xyz", b"<?xml version='1.0'?>\n<!-- x -->\n<job a='1'/>", "XML with the element <job>"),
        ("a.json", b'{"masts": [{"height": 3}]}', 'JSON with the keys "masts", "height", which'),
        ("a.xyz", b"Pkt;Ost;Nord\nA;1,5;2\nB;3;4\n", "a table of 3 columns with semicolons, with "),
        ("a.xyz", b"Pkt;Ost;Nord\nA;1,5;2\nB;3;4\n", "with the header Pkt, Ost, Nord; if it has "),
        ("a.xyz", b"A 1 2\nB 3 4\n", "a table of 3 columns with blanks, without a header; if it "),
        ("a.xyz", b"Dear all,\nhere they are.\n", "text that begins with 'Dear all,'; `factorg"),
        ("a.xyz", b"Gr\xfc\xdfe\nan alle\n", "text that begins with 'Grüße'; "),
    ],
)
def test_a_file_of_no_known_sort_is_described(tmp_path, name, content, expected):
    path = tmp_path / name
    path.write_bytes(content)
    assert expected in said_of(path)


def test_packed_files_are_named_by_what_they_hold(tmp_path):
    for name, member, expected in (
        ("a.docx", "word/document.xml", "looks like a document of Word"),
        ("a.zip", "survey/book.gsi", "is of no known kind: a zip file with [Content_Types].xml, "),
    ):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            archive.writestr("[Content_Types].xml", "")
            archive.writestr(member, "x")
        assert said_of(tmp_path / name).startswith(expected)


def test_no_message_lists_every_format(tmp_path):
    """Three names are help; thirty are none."""
    for name in ("a", "a.xml", "a.json", "a.txt", "a.dat", "a.sdr", "a.raw"):
        (tmp_path / name).write_text("Some words\nof nobody\n", encoding="utf-8")
        with pytest.raises(InputError) as caught:
            fga.read(tmp_path / name)
        named = [r for r in READERS.entries if r.description in str(caught.value)]
        assert len(named) <= 5, str(caught.value)


def test_a_companion_file_names_the_file_that_is_read(tmp_path):
    source = data_dir("gama_3d_networks") / "local_3d.gkf"
    shutil.copy(source, tmp_path / "net.gkf")
    (tmp_path / "net.crd").write_text("some words\nof nobody\n", encoding="utf-8")
    assert said_of(tmp_path / "net.crd").endswith("; beside it: net.gkf (GNU Gama)")
    assert said_of(tmp_path).endswith(f"valid: {tmp_path / 'net.gkf'} (GNU Gama)")


def test_a_damaged_file_with_the_suffix_of_one_format_has_its_problems_by_line(tmp_path):
    (tmp_path / "a.gkf").write_text("<gama-lokal>\n</gama-lokal>\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.gkf:1: "):
        fga.read(tmp_path / "a.gkf")


def test_signatures_do_not_take_what_a_reader_reads(tmp_path):
    for name, form in RECOGNISED.items():
        folder = tmp_path / name
        folder.mkdir()
        path = form.write(folder)
        content = path.read_bytes()[:65536].decode("latin-1")
        found = [s.what for s in SIGNATURES if s.fits(path.suffix.lower(), content)]
        assert not found, (name, found)


REPEATED = (
    "\n",
    "\r\n",
    " \n",
    "\t",
    " ",
    "#\n",
    "% a\n",
    "<!-- ",
    "<?",
    "999\na\n",
    "AP \n",
    "1 2 3\n",
)
"""What a file may repeat, by which an expression with two ways through it goes back for hours."""


@pytest.mark.timeout(60)
@pytest.mark.parametrize("unit", REPEATED)
def test_a_file_of_one_thing_is_refused_or_read_at_once(tmp_path, unit):
    """Every reader is asked about every file: one that hangs would hang on the files of others."""
    path = tmp_path / "a.txt"
    path.write_text(unit * (MAX_RECOGNITION_BYTES // len(unit)), encoding="utf-8")
    for reader in READERS.entries:
        if reader.recognises is not None:
            assert reader.recognises(path) in (True, False)
    assert description(path)
    content = path.read_text(encoding="utf-8")
    assert not [s.what for s in SIGNATURES if s.fits(".txt", content)]


def test_the_command_formats_lists_every_format(capsys):
    assert main(["formats"]) == 0
    printed = capsys.readouterr().out
    for entry in (*READERS.entries, *WRITERS.entries):
        assert f"  {entry.name} " in printed
        assert entry.description in printed
