"""Pictures of the gallery: every script draws its own with ``--plot FILE``.

The scripts are run for the documentation exactly as from the command line; what they write to
FILE is the picture of their page.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst


def _file(script: str) -> Path:
    """Return the file that a script draws into; scripts run in their own folder."""
    return Path(script).with_suffix(".png")


def arguments(gallery_conf: dict[str, Any], script_vars: dict[str, Any]) -> list[str]:
    """Return the arguments of a script: a file for its picture, where it draws one."""
    script = script_vars["src_file"]
    draws = '"--plot"' in Path(script).read_text(encoding="utf-8")
    return ["--plot", _file(script).name] if draws else []


def written_picture(
    block: tuple[str, str, int], block_vars: dict[str, Any], gallery_conf: dict[str, Any]
) -> str:
    """Take the picture that a block has written, and return the markup that shows it."""
    written = _file(block_vars["src_file"])
    if not written.is_file():
        return ""
    target = next(block_vars["image_path_iterator"])
    Path(target).parent.mkdir(parents=True, exist_ok=True)
    shutil.move(written, target)
    return str(figure_rst([target], gallery_conf["src_dir"], "the picture that the script draws"))
