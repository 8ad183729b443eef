"""Pictures of the page of a site in every state, and what a computation finds wrong in them.

``python -m tests.benchmarks.page_states FOLDER [--only NAME…] [--look LOOK…]`` opens every state of
``tests/site/page_catalogue.py`` on a phone and on a desk, light and dark, in English and German,
and writes ``FOLDER/LOOK/STATE.png``. Sheets ``FOLDER/sheet-LOOK-N.png`` have several side by side.
It prints what is hard to read, cut, covered, too small for a finger or wider than the screen, what
the browser complains of, and how many pictures there are. NAME and LOOK are patterns such as
``plan*`` and ``phone-*``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from tests.site.browsers import PHONE
from tests.site.canned_server import CannedServer
from tests.site.page_audits import audit
from tests.site.page_catalogue import STATES, PageState
from tests.support.pages import chromium

DESKTOP = (1280, 800)
MOST_HEIGHT = 2600
"""Of a picture, pixels of the page."""
SHEETS = {"phone": (5, 312, 780), "desk": (2, 780, 780)}
"""Pictures in a row, width of each and height of a sheet, pixels."""
TITLE, GAP = 20, 6


@dataclass(frozen=True)
class Look:
    """How a page is looked at."""

    device: str
    scheme: str
    language: str

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.device}-{self.scheme}-{self.language[:2]}"

    @property
    def options(self) -> dict[str, Any]:
        """What a visitor is opened with."""
        size = PHONE if self.device == "phone" else DESKTOP
        return {"size": size, "scheme": self.scheme, "language": self.language}


LOOKS = tuple(
    Look(device, scheme, language)
    for device in ("phone", "desk")
    for scheme, language in (("light", "en-GB"), ("dark", "en-GB"), ("light", "de-DE"))
)


def picture(state: PageState, look: Look, browser: Any, folder: Path) -> Iterator[str]:
    """Write the picture of a state, and yield what is wrong with it."""
    server = CannedServer(tokens=bool(state.role))
    with ExitStack() as ends:
        ends.callback(server.stop)
        state.prepare(server.site)
        v = ends.enter_context(state.opened(browser, server, **look.options))
        yield from audit(v.page, phone=look.device == "phone")
        expected = "page" if state.before is None and not state.name.startswith("error") else ""
        yield from (f"says {s}" for s in v.complaints if expected)
        file = folder / look.name / f"{state.name}.png"
        file.parent.mkdir(parents=True, exist_ok=True)
        # Dialogs stand in the window; otherwise the whole page is wanted.
        whole = v.page.locator("dialog").count() == 0
        if whole:
            v.page.evaluate("scrollTo(0, 0)")
        width, least = look.options["size"]
        height = v.page.evaluate("document.documentElement.scrollHeight") if whole else least
        clip = {"x": 0, "y": 0, "width": width, "height": min(max(height, least), MOST_HEIGHT)}
        v.page.screenshot(path=file, full_page=whole, clip=clip, scale="css")


def sheets(folder: Path, look: Look) -> int:
    """Write the sheets of a look, and return how many pictures are on them."""
    from PIL import Image, ImageDraw

    columns, width, height = SHEETS[look.device]
    files = sorted((folder / look.name).glob("*.png"))
    for old in folder.glob(f"sheet-{look.name}-*.png"):
        old.unlink()
    made: list[tuple[Any, list[int]]] = []
    for file in files:
        image = Image.open(file).convert("RGB")
        image = image.resize((width, round(image.height * width / image.width)), Image.LANCZOS)
        image = image.crop((0, 0, width, min(image.height, height - TITLE)))
        fits = [
            (sheet, at, c)
            for sheet, at in made
            for c in range(columns)
            if at[c] + TITLE + image.height <= height
        ]
        if not fits:
            sheet, at, c = (
                Image.new("RGB", (columns * (width + GAP), height), "#888"),
                [0] * columns,
                0,
            )
            made.append((sheet, at))
        else:
            sheet, at, c = fits[0]
        x, y = c * (width + GAP), at[c]
        ImageDraw.Draw(sheet).text((x + 4, y + 3), file.stem, "#fff", font_size=13)
        sheet.paste(image, (x, y + TITLE))
        at[c] += TITLE + image.height
    for number, (sheet, _) in enumerate(made, 1):
        sheet.save(folder / f"sheet-{look.name}-{number:02}.png")
    return len(files)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", default=["*"], metavar="NAME")
    parser.add_argument("--look", nargs="+", default=["*"], metavar="LOOK")
    options = parser.parse_args()
    states = [s for s in STATES if any(fnmatchcase(s.name, p) for p in options.only)]
    looks = [k for k in LOOKS if any(fnmatchcase(k.name, p) for p in options.look)]
    if not states or not looks:
        parser.error(f"no state or look; known: {', '.join(s.name for s in STATES)}")
    told: dict[str, list[str]] = {}
    with chromium() as browser:
        for state in states:
            for look in looks:
                try:
                    found = list(picture(state, look, browser, options.folder))
                except Exception as error:  # a state that does not come about is a finding
                    found = [f"did not come about: {str(error).splitlines()[0]}"]
                for what in dict.fromkeys(found):
                    place = f"{state.name} ({look.name})"
                    if what not in told:
                        print(f"{place}: {what}", flush=True)
                    told.setdefault(what, []).append(place)
    n = sum(sheets(options.folder, look) for look in looks)
    for what, where in told.items():
        if len(where) > 1:
            print(f"{len(where)} times: {what}")
    wrong = len({place for where in told.values() for place in where})
    print(f"{n} pictures; {wrong} of {len(states) * len(looks)} looked at now have findings")


if __name__ == "__main__":
    main()
