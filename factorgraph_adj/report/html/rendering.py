"""How a page of HTML is made: its template, with scripts, libraries and texts of its language."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files as resources
from typing import Any

from ...control_characters import escaped
from ...version import __version__
from .language import Texts
from .libraries import libraries, refuse_missing
from .sheets import NONE, PAGE, Sheet

SCRIPTS = ("base.js", "tables.js", "plan.js", "figures.js")
"""Scripts of a page, in the order in which they run."""


@dataclass(frozen=True)
class Section:
    """A part of the page with tables."""

    id: str
    """Name of the part in the page."""
    title: str
    """Its heading."""
    sheets: Sequence[Sheet]
    """Its tables."""
    empty: str = ""
    """What it says without a table; empty: the part is left out."""


def rendered(name: str, t: Texts, contents: Callable[[], Mapping[str, Any]]) -> str:
    """Return a page.

    Args:
        name: name of its template.
        t: texts of its language.
        contents: function that makes what the template fills in, called once it can be filled in.

    Raises:
        InputError: packages of the extra are missing, and what the function raises.
    """
    refuse_missing()
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    def text_of(name: str) -> str:
        return (resources(__package__) / "template" / name).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(text_of),
        autoescape=True,
        finalize=lambda value: escaped(value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name).render(
        t=t,
        language=t.language,
        program=f"factorgraph_adj {__version__}",
        style=text_of("style.css"),
        script="\n".join(text_of(name) for name in SCRIPTS),
        libraries=libraries(),
        page_rows=PAGE,
        none=NONE,
        script_texts=t.of_script(),
        **contents(),
    )


def capital(text: str) -> str:
    """Return a text with a capital letter at its beginning."""
    return text[:1].upper() + text[1:]
