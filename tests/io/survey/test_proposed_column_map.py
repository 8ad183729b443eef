"""Mappings guessed from headers in nine languages, what they leave open, and the command map."""

from __future__ import annotations

import math
import tomllib

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.survey.header_words import HEADER_WORDS, header_unit, header_word, meanings
from factorgraph_adj.io.survey.proposed_column_map import guessed_mapping
from factorgraph_adj.units import FOOT, GON

openpyxl = pytest.importorskip("openpyxl")
LANGUAGES = ("en", "de", "fr", "es", "it", "pt", "nl", "pl", "hu", "ru")
HEADERS = {
    "de": ("Standpunkt", "Zielpunkt", "Horizontalrichtung [gon]", "Zenitwinkel [gon]",
           "Schrägstrecke", "Zielhöhe"),
    "fr": ("Station", "Point visé", "Angle horizontal (gon)", "Angle zénithal (gon)",
           "Distance inclinée", "Hauteur prisme"),
    "es": ("Estación", "Punto visado", "Ángulo horizontal (gon)", "Ángulo cenital (gon)",
           "Distancia inclinada", "Altura prisma"),
    "it": ("Stazione", "Punto collimato", "Angolo orizzontale [gon]", "Angolo zenitale [gon]",
           "Distanza inclinata", "Altezza prisma"),
    "pt": ("Estação", "Ponto visado", "Ângulo horizontal (gon)", "Ângulo zenital (gon)",
           "Distância inclinada", "Altura do prisma"),
    "nl": ("Standplaats", "Richtpunt", "Horizontale hoek [gon]", "Zenithoek [gon]",
           "Schuine afstand", "Prismahoogte"),
    "pl": ("Stanowisko", "Cel", "Kierunek [gon]", "Kąt zenitalny [gon]", "Odległość skośna",
           "Wysokość celu"),
    "hu": ("Álláspont", "Irányzott pont", "Vízszintes szög [gon]", "Zenitszög [gon]",
           "Ferde távolság", "Jelmagasság"),
    "ru": ("Станция", "Цель", "Горизонтальный угол [gon]", "Зенитный угол [gon]",
           "Наклонное расстояние", "Высота цели"),
    "en": ("Station", "Target", "Hz (gon)", "V (gon)", "Slope Distance", "Target height"),
}  # fmt: skip
READING = ("station", "target", "direction", "zenith", "distance", "target_height")


def test_every_column_has_words_of_every_language_as_headers_are_compared():
    for column, words in HEADER_WORDS.items():
        assert tuple(words) == LANGUAGES, column
        for word in " ".join(words.values()).split():
            assert header_word(word) == word
            assert column in meanings(word)


def test_units_stand_in_brackets_or_at_the_end():
    headers = ("Hz [gon]", "dist_ft", "H (US ft)", "V (°)", "Punkt", "Farm")
    assert [header_unit(h) for h in headers] == ["gon", "ft", "us-ft", "deg", "", ""]


@pytest.mark.parametrize("language", LANGUAGES)
def test_readings_in_each_language_are_read_by_the_guess(tmp_path, language):
    path = tmp_path / "book.csv"
    rows = [";".join(HEADERS[language]), "S;A;10,5000;99,1000;25,079;1,600"]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    guess = guessed_mapping(path)
    assert (guess.section, tuple(guess.mapped)) == ("readings", READING)
    network = fga.read(path, mapping="guess")
    of = {o.kind: o for o in network.observations.values()}
    assert of["direction"].value == pytest.approx(10.5 * GON)
    assert of["slope_distance"].value == 25.079
    assert of["slope_distance"].target_height == 1.6
    (remark,) = network.remarks
    assert remark.startswith("columns as readings by a guess from the header: station = ")
    assert "angle gon" in remark


def test_without_a_mapping_the_error_proposes_one_and_nothing_is_read(tmp_path):
    path = tmp_path / "levels.csv"
    path.write_text("from,to,dh,length_km\nA,B,1.5,0.2\nB,C,-0.5,0.3\n", encoding="utf-8")
    with pytest.raises(InputError) as refused:
        fga.read(path)
    (problem,) = refused.value.problems
    what, _, toml = problem.what.partition("\n\n")
    assert (
        "factorgraph-adj guess-columns levels.csv > levels.toml" in what and "mapping=guess" in what
    )
    (tmp_path / "levels.toml").write_text(toml, encoding="utf-8")
    assert tomllib.loads(toml)["units"] == {"length": "m", "line": "km"}
    network = fga.read(path, mapping=tmp_path / "levels.toml")
    assert [o.length_km for o in network.observations.values()] == [0.2, 0.3]


def test_what_the_file_leaves_open_is_refused(tmp_path):
    """Angles below 360 may be degrees or gon: the guess says so, and does not choose."""
    path = tmp_path / "book.csv"
    path.write_text("target,hz,v\nA,10.5,99.1\n", encoding="utf-8")
    guess = guessed_mapping(path)
    assert guess.open_keys == ["angle", "station"]
    with pytest.raises(InputError, match=r"where it says '\?' \(angle, station\)"):
        fga.read(path, mapping="guess")
    with pytest.raises(InputError, match=r"unknown unit '\?'; valid: .*packed"):
        fga.read(path, mapping=tomllib.loads(guess.toml()))
    path.write_text("station,target,hz,v\nS,A,370.5,99.1\n", encoding="utf-8")
    assert guessed_mapping(path).units["angle"] == "gon"
    path.write_text("station,target,hz,v\nS,A,37-05-10,89-10-11.5\n", encoding="utf-8")
    assert guessed_mapping(path).units["angle"] == "dms"


def test_small_numbers_beside_levelled_lines_are_standard_deviations(tmp_path):
    """The heights T1 and T2 of four lines between two bench marks in another table."""
    lines = "from,to,dh,s\nB1,T1,0.8503,0.0015\nT1,T2,0.5698,0.0015\nT2,B2,1.0800,0.0022\n"
    (tmp_path / "levels.csv").write_text(lines + "B1,T2,1.4198,0.0020\n", encoding="utf-8")
    points = "p,h,known\nB1,100.000,true\nB2,102.500,true\n"
    (tmp_path / "points.csv").write_text(points, encoding="utf-8")
    network = fga.read(tmp_path / "levels.csv", mapping="guess")
    assert [o.sigma for o in network.observations.values()] == [0.0015, 0.0015, 0.0022, 0.002]
    solution = fga.adjust(network)
    found = [solution.point(n)[2] for n in ("T1", "T2")]
    assert found == pytest.approx([100.850, 101.420], abs=0.5e-3)
    assert network.points["T1"].held == "xy"


def test_a_table_without_a_header_is_mapped_by_its_cells(tmp_path):
    """Levelled lines as GeoEasy's demonstration has them: from, to, length, difference."""
    path = tmp_path / "levels.dmp"
    path.write_text("B H 232 0.45\nH I 240 -0.074\nI B 300 -0.376\n", encoding="ascii")
    guess = guessed_mapping(path)
    assert guess.mapped == {"station": "1", "target": "2", "difference": "4", "length": "3"}
    network = fga.read(path, format="columns", mapping="guess")
    assert [(o.value, o.length_km) for o in network.observations.values()] == [
        (0.45, 0.232), (-0.074, 0.24), (-0.376, 0.3)
    ]  # fmt: skip
    path.write_text("P1 10.5 20.5 3.5\nP2 11.5 21.5 4.5\n", encoding="ascii")
    assert guessed_mapping(path).mapped == {"name": "1", "x": "2", "y": "3", "z": "4"}


def test_titles_before_the_header_and_code_pages_are_seen(tmp_path):
    path = tmp_path / "points.csv"
    text = "Netz Süd\n\nPunkt\tRechtswert\tHochwert\tHöhe\nA\t10,5\t20,25\t3\n"
    path.write_bytes(text.encode("cp1252"))
    guess = guessed_mapping(path)
    assert guess.keys | {"axes": "en"} == {
        "encoding": "cp1252", "delimiter": "tab", "header": 3, "decimal": ",", "axes": "en"
    }  # fmt: skip
    network = fga.read(path, mapping="guess")
    assert tuple(network.points["A"].coordinates) == (10.5, 20.25, 3.0)


def test_points_are_held_by_words_of_each_language(tmp_path):
    path = tmp_path / "points.csv"
    rows = ["Punkt;Rechts;Hoch;Höhe;fest", "A;1;2;3;ja", "B;1;2;;oui", "C;1;2;3;nein", "D;1;2;3;xy"]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    network = fga.read(path, mapping="guess")
    assert [p.held for p in network.points.values()] == ["xyz", "xy", "", "xy"]
    path.write_text("Punkt;Rechts;Hoch;Höhe;fest\nB;1;2;;xyz\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"points\.csv:2: z is held, but has no value"):
        fga.read(path, mapping="guess")


def test_an_unknown_header_leaves_the_table_open(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("alpha,beta\nq1,q2\n", encoding="ascii")
    with pytest.raises(InputError, match=r"# not mapped: \"alpha\", \"beta\""):
        fga.read(path)


def test_the_command_prints_a_mapping_that_the_next_one_reads(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = "from,to,dh,length\nA,B,1.5,100\nB,C,1.0,100\nC,A,-2.5,100\n"
    (tmp_path / "p.csv").write_text(lines, encoding="ascii")
    assert main(["guess-columns", "p.csv"]) == 0
    (tmp_path / "p.toml").write_text(capsys.readouterr().out, encoding="utf-8")
    assert main(["adjust", "p.csv", "--set", "mapping=p.toml"]) == 0
    assert "3 observations" in capsys.readouterr().out
    (tmp_path / "p.csv").write_text("target,hz\nA,10\n", encoding="ascii")
    assert main(["guess-columns", "p.csv"]) == 2
    printed = capsys.readouterr()
    assert 'angle = "?"' in printed.out and "to be completed: angle, station" in printed.err


# -- units, dimension, workbooks ------------------------------------------------------------------


def test_feet_and_packed_degrees(tmp_path):
    path = tmp_path / "b.csv"
    path.write_text("from,to,hz,v,sd\nS,A,10.3030,90.0000,100\n", encoding="ascii")
    mapping = {
        "units": {"length": "ft", "angle": "packed"},
        "readings": {"station": "from", "target": "to", "direction": "hz", "zenith": "v",
                     "distance": "sd"},
    }  # fmt: skip
    of = {o.kind: o.value for o in fga.read(path, mapping=mapping).observations.values()}
    assert of["direction"] == pytest.approx(math.radians(10 + 30 / 60 + 30 / 3600))
    assert of["slope_distance"] == pytest.approx(100 * FOOT)
    mapping["units"]["length"] = "us-ft"
    of = {o.kind: o.value for o in fga.read(path, mapping=mapping).observations.values()}
    assert of["slope_distance"] == pytest.approx(100 * 1200 / 3937)
    del mapping["readings"]
    mapping["observations"] = {"kind": "=direction", "station": "from", "target": "to",
                               "value": "hz"}  # fmt: skip
    with pytest.raises(InputError, match=r"b\.csv:2: other observations have units of a project"):
        fga.read(path, mapping=mapping)


def test_a_plane_network_has_no_heights(tmp_path):
    path = tmp_path / "b.csv"
    path.write_text("from,to,hz,v,sd\nS,A,10,99,30\nS,B,20,,\nS,C,,98,\n", encoding="ascii")
    mapping = {
        "dimension": 2,
        "readings": {"station": "from", "target": "to", "direction": "hz", "zenith": "v",
                     "distance": "sd"},
    }  # fmt: skip
    network = fga.read(path, mapping=mapping)
    kinds = [(o.kind, o.target) for o in network.observations.values()]
    assert sorted(kinds) == [("direction", "A"), ("direction", "B"), ("horizontal_distance", "A")]
    of = {o.kind: o for o in network.observations.values()}
    assert of["horizontal_distance"].value == pytest.approx(30 * math.sin(99 * GON))
    assert {p.held for p in network.points.values()} == {"z"}
    assert [r.names for r in network.left_out] == [("C",)]
    whole = fga.read(path, mapping=mapping, dimension=3)
    assert "slope_distance" in {o.kind for o in whole.observations.values()}


def test_a_network_of_heights_leaves_out_readings(tmp_path):
    path = tmp_path / "b.csv"
    path.write_text("from,to,dh,hz\nS,A,1.5,\nS,A,,10\n", encoding="ascii")
    both = {"station": "from", "target": "to"}
    mapping = {
        "levelling": {**both, "difference": "dh"},
        "readings": {**both, "direction": "hz"},
    }
    path.write_text("from,to,dh,hz\nS,A,1.5,10\n", encoding="ascii")
    network = fga.read(path, mapping=mapping, dimension=1)
    assert [o.kind for o in network.observations.values()] == ["height_difference"]
    assert {p.held for p in network.points.values()} == {"xy"}
    assert [r.count for r in network.left_out] == [1]


def workbook(path, sheets: dict[str, list[list[object]]]) -> None:
    """Write a workbook."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)


def test_sheets_of_a_workbook_are_read_by_name(tmp_path):
    path = tmp_path / "survey.xlsx"
    workbook(
        path,
        {
            "Raw": [["RTS", "Target", "Hz [deg]", "Vz [deg]", "Sd"],
                    [1, 101, 72.5, 90.25, 78.41], [1, 102.0, 73.5, 91, 70]],
            "Header": [["Point ID", "Easting", "Northing", "Height"], [1, 1000.5, 2000.25, 30]],
        },
    )  # fmt: skip
    with pytest.raises(InputError, match=r"survey\.xlsx: has 2 sheets, Raw, Header"):
        fga.read(path)
    with pytest.raises(InputError, match="has no sheet 'raw'; valid: Raw, Header; did you mean"):
        fga.read(path, sheet="raw")
    network = fga.read(path, sheet="Raw", mapping="guess")
    of = {(o.target, o.kind): o for o in network.observations.values()}
    assert of["101", "slope_distance"].value == 78.41
    assert of["102", "direction"].value == pytest.approx(math.radians(73.5))
    assert of["102", "direction"].source == "survey.xlsx:3"
    mapping = guessed_mapping(path, "Raw").checked()
    mapping["points"] = {"sheet": "Header", "name": "Point ID", "x": "Easting", "y": "Northing",
                         "z": "Height"}  # fmt: skip
    network = fga.read(path, mapping=mapping)
    assert tuple(network.points["1"].coordinates) == (1000.5, 2000.25, 30.0)


def test_a_damaged_workbook_is_refused(tmp_path):
    path = tmp_path / "survey.xlsx"
    workbook(path, {"Raw": [["Name", "E"], ["A", 1]]})
    content = path.read_bytes()
    for damaged in (content[:500], content[:200] + b"\0" * 400 + content[600:], b"Name,E\n"):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"survey\.xlsx"):
            fga.read(path, format="columns")
