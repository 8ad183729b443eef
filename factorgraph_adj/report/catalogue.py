"""Catalogue of texts of pages, verdicts and names of kinds by identifier, in English and German.

The texts are data: ``html/catalogue/en.toml`` and ``de.toml`` have the same identifiers.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from typing import Literal, TypeAlias, get_args

from ..errors import InputError
from ..models.unknown_registry import UNKNOWNS
from ..observations.registry import KINDS

Language: TypeAlias = Literal["en", "de"]
"""Languages of the report."""
_CATALOGUES = {
    name: tomllib.loads(
        (files(__package__) / "html" / "catalogue" / f"{name}.toml").read_text(encoding="utf-8")
    )
    for name in get_args(Language)
}
TEXTS_BY_LANGUAGE: dict[str, dict[str, str]] = {n: c["texts"] for n, c in _CATALOGUES.items()}
"""Texts by language and identifier."""
KINDS_BY_LANGUAGE: dict[str, dict[str, str]] = {n: c["kinds"] for n, c in _CATALOGUES.items()}
"""Names of kinds of observations and unknowns; the record of a kind may state what is missing here,
and a name that neither has stays English."""
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
        if self.language not in TEXTS_BY_LANGUAGE:
            valid = ", ".join(get_args(Language))
            raise InputError(f"unknown language {self.language!r}; valid: {valid}")

    def __call__(self, key: str, **figures: object) -> str:
        """Return a text with its figures in place."""
        text = TEXTS_BY_LANGUAGE[self.language][key]
        return text.format(**figures) if figures else text

    def number(self, key: str, n: int, **figures: object) -> str:
        """Return a text about n things: ``key_one`` for a single one, else ``key_many``."""
        return self(f"{key}_one" if n == 1 else f"{key}_many", n=n, **figures)

    def heading(self, title: str) -> str:
        """Return the heading of a column: its text, or a symbol as it stands."""
        return TEXTS_BY_LANGUAGE[self.language].get(f"col_{title}", title)

    def script_texts(self) -> dict[str, str]:
        """Return the texts that the script of the page shows."""
        every = TEXTS_BY_LANGUAGE[self.language]
        return {k: text for k, text in every.items() if k.startswith("js_")}

    def kind(self, label: str) -> str:
        """Return the name of a kind, or of a group such as ``image, P31``."""
        name, comma, rest = label.partition(", ")
        found = self._kind(name)
        if not found and name.startswith(_WEIGHTED):
            inner = self._kind(name.removeprefix(_WEIGHTED))
            found = f"{self('weighted')} {inner}" if inner else ""
        return f"{found or name}{comma}{rest}"

    def _kind(self, name: str) -> str:
        key = name.replace(" ", "_")
        return KINDS_BY_LANGUAGE[self.language].get(key) or self._stated_by_record(key)

    def _stated_by_record(self, key: str) -> str:
        """Return the name that the record of a kind of observation or unknown states itself."""
        if key in KINDS:
            return KINDS[key].titles.get(self.language, "")
        titled = (u for u in UNKNOWNS.values() if key in (u.name, u.title.replace(" ", "_")))
        return next((u.titles.get(self.language, "") for u in titled), "")

    def kinds(self, kinds: Iterable[str]) -> str:
        """Return the names of kinds as they are registered."""
        return ", ".join(self.kind(k.replace("_", " ")) for k in kinds)
