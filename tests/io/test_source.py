"""Fields of files: one rule for numbers, names, choices and flags, and one list of problems."""

from __future__ import annotations

import math

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.io.numbers import PACKED_DEGREES
from factorgraph_adj.io.source import (
    MAX_KEPT_PROBLEMS,
    MAX_LISTED_PROBLEMS,
    Problems,
    Source,
    TextSource,
    is_unread,
)
from factorgraph_adj.io.xml_source import XmlSource


def field(value: object, problems: Problems | None = None):
    return (Problems() if problems is None else problems).field(value, "c", "a.dat:3")


@pytest.mark.parametrize(
    ("text", "value"),
    [("2e10", 2e10), ("1D3", 1e3), ("1d-3", 1e-3), (" -.5 ", -0.5), ("+7.", 7.0), (5, 5.0)],
)
def test_numbers_of_all_programs_are_read(text, value):
    problems = Problems()
    assert field(text, problems).number() == value
    assert problems.count == 0


@pytest.mark.parametrize(
    ("text", "limits", "said"),
    [
        ("1,5", {}, "c: '1,5' is not a number; write a decimal point"),
        ("1e13", {}, "c must be at most 1e+12, not 1e13"),
        ("nan", {}, "c: 'nan' is not a finite number"),
        ("1e999", {}, "c: '1e999' is not a finite number"),
        ("0", {"above": 0.0}, "c must be greater than zero, not 0"),
        ("7", {"largest": 5.0}, "c must be at most 5, not 7"),
        ("-1", {"least": 0.0}, "c must be at least 0, not -1"),
        ("1_0", {}, "c: '1_0' is not a number"),
        (True, {}, "c: True is not a number"),
        (" ", {"above": 0.0}, "c is missing; valid: a number greater than zero"),
        (None, {}, "c is missing; valid: a number"),
    ],
)
def test_each_mistake_of_a_number_has_one_wording(text, limits, said):
    problems = Problems()
    assert math.isnan(field(text, problems).number(**limits))
    assert [str(p) for p in problems.problems] == [f"a.dat:3: {said}"]


def test_units_and_defaults():
    assert field("1.5").number("mm") == 0.0015
    assert field("2").number(scale=0.3048) == 2 * 0.3048
    assert field("").number(default=7.0) == 7.0
    assert field("1-30-0").number("dms") == pytest.approx(math.radians(1.5))
    assert field("1 2\t 3").numbers(3) == (1.0, 2.0, 3.0)
    assert field([1, 2]).numbers(2) == (1.0, 2.0)
    assert field("12").integer() == 12
    assert field("6.").integer() == 6
    assert field("b").choice({"a": 1, "b": 2}) == 2
    assert field("yes").flag()
    assert not field(False).flag()
    assert field(" A 1 ").name() == "A 1"


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("123.45300", 123 + 45 / 60 + 30 / 3600),
        ("123.453", 123 + 45 / 60 + 30 / 3600),
        ("0012.3", 12.5),
        (" -0.00015 ", -1.5 / 3600),
        ("359.5959999", 359 + 59 / 60 + 59.999 / 3600),
        ("7", 7.0),
        (90, 90.0),
    ],
)
def test_packed_degrees_are_a_unit_of_numbers(text, degrees):
    assert field(text).number(PACKED_DEGREES) == pytest.approx(math.radians(degrees), rel=1e-15)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("12.6000", "c: '12.6000' has 60 or more minutes or seconds; packed degrees are D.MMSSs"),
        ("12.3060", "c: '12.3060' has 60 or more minutes or seconds"),
        ("12.306", "c: '12.306' has 60 or more minutes or seconds"),
        ("1000.3", "c: '1000.3' is not packed degrees D.MMSSs, such as 102.34125 for 102° 34′"),
        ("12-30-00", "c: '12-30-00' is not packed degrees"),
        ("1e2", "c: '1e2' is not packed degrees"),
        (".", "c: '.' is not packed degrees"),
        ("", "c is missing; valid: a number"),
    ],
)
def test_what_is_no_packed_degrees_is_refused(text, said):
    problems = Problems()
    assert math.isnan(field(text, problems).number(PACKED_DEGREES))
    assert str(problems.problems[0]).startswith(f"a.dat:3: {said}")


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (lambda p: field("1 2", p).numbers(3), "c needs 3 numbers, not 2"),
        (lambda p: field("1,5", p).numbers(2), "c needs 2 numbers, not 1"),
        (lambda p: field("1 x 2", p).numbers(3), "c: 'x' is not a number"),
        (lambda p: field("1.5", p).integer(), "c must be a whole number ≥ 0, not '1.5'"),
        (lambda p: field("9" * 5000, p).integer(largest=9), "c must be a whole number from 0 to 9"),
        (lambda p: field("fou", p).choice({"four": 4}), "c 'fou' is unknown; valid: four; did you"),
        (lambda p: field("", p).name(), "c is missing; valid: a name"),
        (lambda p: field("a\x07", p).name(), "c must be a name: "),
    ],
)
def test_what_cannot_be_read_is_known_as_unread(read, said):
    problems = Problems()
    assert is_unread(read(problems))
    (problem,) = problems.problems
    assert problem.what.startswith(said)


def test_problems_come_in_the_order_of_files_and_lines_each_once(tmp_path):
    problems = Problems()
    first, second = Source(tmp_path / "b.dat", problems), Source(tmp_path / "a.dat", problems)
    for source, line in ((second, 3), (first, 12), (first, 2), (first, 2)):
        source.wrong(line, "wrong")
    with pytest.raises(InputError) as error:
        problems.raise_all()
    assert [p.where for p in error.value.problems] == ["b.dat:2", "b.dat:12", "a.dat:3"]


def test_lines_that_are_numbered_on_are_those_of_their_files(tmp_path):
    source = Source(tmp_path / "main.dat")
    source.continue_with(tmp_path / "part.dat", 10)
    source.last = 12
    assert [source.place(line) for line in (1, 10, 11, 0)] == [
        "main.dat:1",
        "main.dat:10",
        "part.dat:1",
        "part.dat:2",
    ]


def test_a_file_of_another_format_has_a_short_list_of_problems():
    problems = Problems()
    n = MAX_KEPT_PROBLEMS + 5
    for line in range(n):
        problems.wrong("wrong", f"a.dat:{line + 1}")
    with pytest.raises(InputError) as error:
        problems.raise_all()
    found = error.value.problems
    assert len(found) == MAX_LISTED_PROBLEMS + 1
    assert str(found[-1]) == f"a.dat: and {n - MAX_LISTED_PROBLEMS} further problems"


@pytest.mark.parametrize(
    ("encoding", "page"), [("utf-8-sig", ""), ("utf-16", ""), ("cp1252", "cp1252")]
)
def test_encodings_of_text(tmp_path, encoding, page):
    path = tmp_path / "a.dat"
    path.write_bytes("Prüf 1\r\n\r\nß 2\r\n".encode(encoding))
    source = TextSource(path, code_page=page)
    assert list(source.filled()) == [(1, "Prüf 1"), (3, "ß 2")]


def test_other_encodings_are_refused_with_the_line(tmp_path):
    path = tmp_path / "a.dat"
    path.write_bytes("A 1\nPrüf 1\n".encode("cp1252"))
    with pytest.raises(InputError, match=r"a\.dat:2: is not UTF-8 text"):
        TextSource(path)


def test_elements_and_attributes_are_fields(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text("<a>\n<p id='P'><x> 1.5 </x></p>\n<p><x>y</x></p></a>")
    source = XmlSource(path, "a")
    first, second = source.root.all("p")
    assert source.attribute(first, "id").name() == "P"
    assert source.inside(first, "x").number() == 1.5
    assert source.inside(first, "z").number(default=2.0) == 2.0
    assert is_unread(source.attribute(second, "id").name(), source.inside(second, "x").number())
    with pytest.raises(InputError) as error:
        source.raise_all()
    assert [str(p) for p in error.value.problems] == [
        "a.xml:3: id of <p> is missing; valid: a name",
        "a.xml:3: <x>: 'y' is not a number",
    ]
    with pytest.raises(InputError, match="root element must be <b>, not <a>"):
        XmlSource(path, "b")
