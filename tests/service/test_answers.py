"""Answers of the stream: what is cut, and what is kept."""

from __future__ import annotations

from factorgraph_adj.errors import known
from factorgraph_adj.service.answers import MAX_LETTERS_OF_PROBLEM, cut_short


def test_a_long_list_of_valid_names_is_cut_before_the_name_that_was_meant():
    names = [f"kind_of_observation_{i:c}" for i in range(ord("a"), ord("a") + 60)]
    what = f"unknown kind 'knd_of_observation_b'; valid: {known([*names, 'given'], most=99)}"
    what += known(["given"], meant="givn").removeprefix("given")
    assert len(what) > MAX_LETTERS_OF_PROBLEM + 100
    cut = cut_short(what)
    assert cut.endswith(", …; did you mean 'given'?") and len(cut) < MAX_LETTERS_OF_PROBLEM + 40
    assert all(name in names for name in cut.partition("valid: ")[2].split(", ")[:-1])


def test_a_long_quotation_is_cut_at_its_end():
    assert cut_short("x" * 5000) == "x" * MAX_LETTERS_OF_PROBLEM + "…"
    assert len(cut_short("x" * 5000 + "; did you mean " + "y" * 5000)) <= MAX_LETTERS_OF_PROBLEM + 1
    assert cut_short("short; did you mean 'a'?") == "short; did you mean 'a'?"
