"""Networks of GNU Gama whose files have observations of points that they do not list."""

from __future__ import annotations

import re
from pathlib import Path

import factorgraph_adj as fga
from tests.support.places import data_dir


def gama_epoch(name: str, folder: Path) -> Path:
    """Write a network without the observations of points that it does not list."""
    text = (data_dir("gama_deformation") / name).read_text(encoding="utf-8")
    points = set(re.findall(r"<point id='(\w+)'", text))

    def kept(match: re.Match[str]) -> str:
        return match[0] if match[1] in points else ""

    text = re.sub(r"<obs from='(\w+)'>.*?</obs>", kept, text, flags=re.S)
    text = re.sub(r"<\w+[^<>]* to='(\w+)'[^<>]*/>", kept, text)
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def adjusted_epoch(number: int, folder: Path) -> fga.Solution:
    """Return the adjustment of one of the two epochs."""
    return fga.adjust(fga.read_gama(gama_epoch(f"data-{number}.gkf", folder)))
