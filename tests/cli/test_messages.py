"""Messages show control characters of inputs, and do not send them to the terminal."""

from __future__ import annotations

from factorgraph_adj.cli.messages import print_problems, print_warnings
from factorgraph_adj.errors import Problem


def test_control_characters_are_escaped(capsys):
    steering = "".join(chr(c) for c in (*range(32), *range(127, 160)) if chr(c) not in "\n\t")
    problem = Problem(f"unknown point P{steering}Q", f"a\x1b[2J{steering}.csv:1")
    print_problems([problem])
    print_problems([problem], every=True)
    print_warnings([problem])
    said = capsys.readouterr().err
    assert not set(said) & set(steering)
    assert said.count("a\\x1b[2J") == 3
