"""Attributes of a network that are its stated unknowns of one kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from ..models.variables import VariableKind
from .entities import Parameter


class Holder(Protocol):
    """What has stated unknowns by kind and key."""

    parameters: dict[VariableKind, dict[Any, Parameter]]
    """The unknowns."""

    def of_kind(self, kind: VariableKind) -> dict[Any, Parameter]:
        """Return the stated unknowns of a kind by key."""


class OfKind:
    """Attribute of a network: its stated unknowns of one kind by key."""

    def __init__(self, kind: VariableKind) -> None:
        self.kind = kind

    def __get__(self, network: Holder, owner: object = None) -> dict[Any, Parameter]:
        return network.of_kind(self.kind)

    def __set__(self, network: Holder, given: Mapping[Any, Parameter]) -> None:
        # A copy of the network may share the table of kinds, so that it is not written into.
        network.parameters = {**network.parameters, self.kind: dict(given)}
