"""Other sizes of the rule that chooses an elimination, and QR for any network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import pytest

from factorgraph_adj.graph.equations import Equations
from factorgraph_adj.solve import elimination_layers, leverages, reduced_system
from factorgraph_adj.solve.linearised_equations import ExtraRows
from factorgraph_adj.solve.normal_equations import Solver


def set_rule(patch: pytest.MonkeyPatch, **sizes: int) -> None:
    """Let the rule have other sizes."""
    rule = replace(elimination_layers.RULE, **sizes)
    for module in (elimination_layers, leverages, reduced_system):
        patch.setattr(module, "RULE", rule)


@contextmanager
def rule(**sizes: int) -> Iterator[None]:
    """Let the rule have other sizes for a while."""
    with pytest.MonkeyPatch.context() as patch:
        set_rule(patch, **sizes)
        yield


@contextmanager
def everything_by_qr() -> Iterator[None]:
    """Factorise every network by QR of all unknowns for a while."""
    of = Solver.of

    def turned(equations: Equations, extra: Sequence[ExtraRows] = ()) -> Solver:
        solver = of(equations, extra)
        solver.turn_to_qr()
        return solver

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Solver, "of", turned)
        yield
