"""Records of kinds of unknowns, and lens models: wrong ones raise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import Lens
from factorgraph_adj.models.lens_registry import LENSES, register_lens
from factorgraph_adj.models.unknown_registry import Component, register_unknown
from tests.networks.extension import (
    SIMILARITY,
    registered,
)


@pytest.fixture(autouse=True)
def kinds() -> Iterator[None]:
    """Let the package know the kinds of `tests.networks.extension`."""
    with registered():
        yield


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"name": "Similarity 2"}, "lower-case letters"),
        ({"name": "edm"}, "a kind of this name is registered already"),
        ({"name": "other", "noun": ""}, "its noun is missing"),
        ({"name": "other"}, "its letter 'S' belongs to the kind 'similarity'"),
        ({"name": "other", "letter": "xx"}, "must be one letter"),
        ({"name": "other", "letter": "x"}, "its table 'similarities' belongs to the kind"),
        ({"name": "other", "letter": "x", "table": None}, "its table is missing"),
        ({"name": "other", "letter": "x", "motions": None}, "it connects, so that motions"),
        ({"name": "other", "components": (Component("a"), Component("a"))}, "different names"),
        ({"name": "other", "variable_size": True}, "cannot have fewer components"),
        ({"name": "other", "components": (Component("a"),) * 1}, "three components of rotation"),
        ({"name": "other", "default": (0.0,)}, "its default must be 7 values"),
        ({"name": "other", "absent": "default"}, "absent names mean a default"),
    ],
)
def test_a_wrong_kind_of_unknown_is_refused(change: dict[str, Any], what: str) -> None:
    with pytest.raises(fga.InputError, match=what):
        register_unknown(replace(SIMILARITY, **change))


def test_a_lens_is_a_class_and_one_call() -> None:
    @dataclass(frozen=True)
    class Named(Lens):
        """An ideal camera under another name."""

        kind: ClassVar[str] = "named"

    register_lens(Named)
    try:
        assert LENSES["named"] is Named
        with pytest.raises(fga.InputError, match="registered already"):
            register_lens(type("Other", (Lens,), {"kind": "named"}))
        with pytest.raises(fga.InputError, match="must be a class derived from Lens"):
            register_lens(int)  # type: ignore[arg-type]
    finally:
        del LENSES["named"]
    with pytest.raises(fga.InputError, match="registered already"):
        register_lens(type("Same", (Lens,), {}))
    packed = {"kind": "packed", "residual": lambda self, *_, **__: None}
    with pytest.raises(fga.InputError, match="must define partials, or _correction"):
        register_lens(type("Packed", (Lens,), packed))
