"""The words of the HTML report in the languages that it speaks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from ...errors import InputError
from . import english, german

Language: TypeAlias = Literal["en", "de"]
"""Languages of the report."""

TEXTS: dict[str, dict[str, str]] = {"en": english.TEXTS, "de": german.TEXTS}
"""Texts by language and key."""
KINDS: dict[str, dict[str, str]] = {"en": {}, "de": german.KINDS}
"""Names of kinds of observations and unknowns; one that is missing keeps its English name."""

_WEIGHTED = "weighted "
"""Beginning of the names of given values of unknowns as observations."""


@dataclass(frozen=True)
class Texts:
    """The texts of one language.

    Raises:
        InputError: the language is unknown.
    """

    language: str
    """``en`` or ``de``."""

    def __post_init__(self) -> None:
        """Check the language."""
        if self.language not in TEXTS:
            valid = ", ".join(get_args(Language))
            raise InputError(f"unknown language {self.language!r}; valid: {valid}")

    def __call__(self, key: str, **figures: object) -> str:
        """Return a text with its figures in place."""
        text = TEXTS[self.language][key]
        return text.format(**figures) if figures else text

    def number(self, key: str, n: int, **figures: object) -> str:
        """Return a text about n things: ``key.one`` for a single one, else ``key.many``."""
        return self(f"{key}.one" if n == 1 else f"{key}.many", n=n, **figures)

    def of_script(self) -> dict[str, str]:
        """Return the texts that the script of the page shows."""
        return {k: text for k, text in TEXTS[self.language].items() if k.startswith("js.")}

    def kind(self, label: str) -> str:
        """Return the name of a kind, or of a group such as ``image, P31``."""
        names = KINDS[self.language]
        name, comma, rest = label.partition(", ")
        if name not in names and name.startswith(_WEIGHTED):
            inner = name.removeprefix(_WEIGHTED)
            name = f"{self('weighted')} {names[inner]}" if inner in names else name
        return f"{names.get(name, name)}{comma}{rest}"

    def kinds(self, kinds: Iterable[str]) -> str:
        """Return the names of kinds as they are registered."""
        return ", ".join(self.kind(k.replace("_", " ")) for k in kinds)
