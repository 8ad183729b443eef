"""Texts that are no numbers are called what they probably are."""

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.io.numbers import parse_quantity
from factorgraph_adj.io.observation_records import observation_from_record


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("195,5109", "write a decimal point"),
        ("5,185.200", "separators of thousands"),
        ("5'185.200", "separators of thousands"),
        ("5 185.200", "separators of thousands"),
        ("−2.6695", "its minus is another character"),
        ("–2.6695", "its minus is another character"),
        ("1. Mai 95", "a spreadsheet may have made a date of it"),
        ("01.05.1995", "a spreadsheet may have made a date of it"),
        ("Mai 95", "a spreadsheet may have made a date of it"),
        ("88-20-24", "with the unit dms"),
        ("88 20 24.5", "with the unit dms"),
    ],
)
def test_what_a_text_may_be_is_told(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse_quantity(text)


@pytest.mark.parametrize("text", ["5o", "abc", "1.2.3.4", "--3", "P12", "10 m"])
def test_of_other_texts_nothing_is_guessed(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not a number$"):
        parse_quantity(text)


def test_a_header_that_is_there_again_is_called_so() -> None:
    with pytest.raises(InputError, match="this row is the header again"):
        observation_from_record({"kind": "kind", "station": "station", "target": "target"})
