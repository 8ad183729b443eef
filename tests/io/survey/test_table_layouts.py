"""Tables of a mapping with layouts of their own: encoding, header, decimals, delimiter."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError

READINGS = "Ziel;V;S\nA;100,0000;60,0\nHügel;95,0000;50,0\n"
LIST = "exported by another program\nHügel,10.5,20.5\nA,0.0,0.0\n"
MAPPING = {
    "decimal": ",",
    "points": {
        "file": "list.csv",
        "encoding": "cp1252",
        "header": 0,
        "decimal": ".",
        "delimiter": "comma",
        **{"name": "1", "x": "2", "y": "3"},
    },
    "readings": {"station": "=S", "target": "Ziel", "zenith": "V", "distance": "S"},
}


def written(tmp_path, listed: str = LIST.partition("\n")[2], *, encoding: str = "cp1252"):
    """Write readings in UTF-8 and a list of points; return the former."""
    (tmp_path / "list.csv").write_text(listed, encoding=encoding)
    path = tmp_path / "book.csv"
    path.write_text(READINGS, encoding="utf-8")
    return path


def test_a_table_has_its_own_encoding_header_decimals_and_delimiter(tmp_path) -> None:
    network = fga.read(written(tmp_path), mapping=MAPPING)
    assert np.allclose(network.points["Hügel"].coordinates[:2], (10.5, 20.5))
    distances = [o.value for o in network.observations.values() if o.kind == "slope_distance"]
    assert distances == [60.0, 50.0]


def test_a_table_has_the_layout_of_the_mapping_where_it_states_none(tmp_path) -> None:
    points = {k: v for k, v in MAPPING["points"].items() if k != "decimal"}
    mapping = {**MAPPING, "points": points}
    text = LIST.partition("\n")[2].replace(",", ";").replace(".", ",")
    path = written(tmp_path, text)
    network = fga.read(path, mapping={**mapping, "points": points | {"delimiter": "semicolon"}})
    assert np.allclose(network.points["Hügel"].coordinates[:2], (10.5, 20.5))


def test_a_header_of_one_table_may_come_later(tmp_path) -> None:
    text = "exported by another program\nName,E,N\nHügel,10.5,20.5\n"
    points = {**MAPPING["points"], "header": 2, "name": "Name", "x": "E", "y": "N"}
    network = fga.read(written(tmp_path, text), mapping={**MAPPING, "points": points})
    assert network.points["Hügel"].coordinates[0] == 10.5


def test_the_same_in_a_file_of_the_mapping(tmp_path) -> None:
    toml = (
        'decimal = ","\n[points]\nfile = "list.csv"\nencoding = "cp1252"\nheader = 0\n'
        'decimal = "."\nname = "1"\nx = "2"\ny = "3"\n'
        '[readings]\nstation = "=S"\ntarget = "Ziel"\nzenith = "V"\ndistance = "S"\n'
    )
    (tmp_path / "mapping.toml").write_text(toml, encoding="utf-8")
    network = fga.read(written(tmp_path), mapping=str(tmp_path / "mapping.toml"))
    assert np.allclose(network.points["Hügel"].coordinates[:2], (10.5, 20.5))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"encoding": "klingon"}, r"mapping: \[points\]: unknown encoding 'klingon'"),
        ({"header": -1}, r"mapping: \[points\]: header must be a line, or 0, not -1"),
        ({"header": "1"}, r"mapping: \[points\]: header must be a line, or 0, not '1'"),
        ({"header": True}, r"mapping: \[points\]: header must be a line"),
        ({"decimal": ";"}, r"mapping: \[points\]: decimal must be one of"),
        ({"delimiter": ",,"}, r"mapping: \[points\]: delimiter must be a character"),
        ({"encoding": "utf-8"}, r"list.csv:1: is not utf-8 text: state encoding"),
    ],
)
def test_a_wrong_layout_names_its_table(tmp_path, change, said) -> None:
    mapping = {**MAPPING, "points": {**MAPPING["points"], **change}}
    with pytest.raises(InputError, match=said):
        fga.read(written(tmp_path), mapping=mapping)
