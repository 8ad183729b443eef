"""HTML reports for tests: their packed data, their elements, and a browser that is offline."""

from __future__ import annotations

import gzip
import json
import re
import shutil
from base64 import b64decode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

import pytest

from tests.support.processes import HANGS

Read = TypeVar("Read")

VOID = {"meta", "link", "input", "br", "hr", "img"}
"""Elements without an end."""
ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Of Chromium: root has no sandbox, and a machine of tests has no graphics card."""


@dataclass
class Element:
    """An element of a page."""

    tag: str
    attributes: dict[str, str]
    text: str = ""
    """All text in it."""
    path: tuple[str, ...] = ()
    """Elements around it, outermost first."""


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[Element] = []
        self.open: list[Element] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        path = tuple(e.tag for e in self.open)
        element = Element(tag, {k: v or "" for k, v in attrs}, path=path)
        self.found.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1].tag == tag, f"</{tag}> closes {self.open[-1:]}"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        for element in self.open:
            element.text += data


def elements(page: str) -> list[Element]:
    """Return the elements of a page, which must be closed in order."""
    reader = _Reader()
    reader.feed(page)
    reader.close()
    assert not reader.open, [e.tag for e in reader.open]
    return reader.found


def data_of(page: str, key: str) -> Any:
    """Return data that are packed in a page."""
    found = re.search(rf'<script type="text/plain" id="data-{re.escape(key)}">([^<]*)<', page)
    assert found, key
    return json.loads(gzip.decompress(b64decode(found[1])))


@dataclass
class Opened:
    """A page in a browser, with all that it said and asked for."""

    page: Any
    said: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def ready(self) -> None:
        """Wait until everything is drawn."""
        self.page.wait_for_selector("html[data-all]", state="attached")

    def until(self, read: Callable[[], Read], holds: Callable[[Read], bool]) -> Read:
        """Wait until what is read of the page is as it should be, and return it.

        Figures are drawn anew some time after what asks for it, by the load of the machine.
        """
        begin, found = monotonic(), read()
        while not holds(found):
            assert monotonic() - begin < HANGS, f"stays {found}"
            self.page.wait_for_timeout(20)
            found = read()
        return found

    def seconds(self) -> float:
        """Return the CPU seconds that the process of the page has taken."""
        client = self.page.context.new_cdp_session(self.page)
        client.send("Performance.enable")
        metrics = {m["name"]: m["value"] for m in client.send("Performance.getMetrics")["metrics"]}
        return float(metrics["ProcessTime"])

    def rows(self, name: str) -> list[list[str]]:
        """Return the cells of the shown rows of a table, once it is alive."""
        self.alive(name)
        script = "t => [...t.tBodies[0].rows].map(r => [...r.cells].map(c => c.textContent))"
        found: list[list[str]] = self.page.eval_on_selector(f"#table-{name}", script)
        return found

    def alive(self, name: str) -> Any:
        """Scroll to a table, wait until it sorts and filters, and return it."""
        table = self.page.locator(f"#table-{name}")
        table.scroll_into_view_if_needed()
        self.page.wait_for_selector(f"#table-{name}[data-made]")
        return table

    def chosen(self) -> list[str]:
        """Wait for a row that was brought into view, and return its cells."""
        row = self.page.wait_for_selector("tr.chosen")
        found: list[str] = row.evaluate("r => [...r.cells].map(c => c.textContent)")
        return found


@contextmanager
def chromium() -> Iterator[Any]:
    """Start a browser; skip the test, saying why, where there is none."""
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("no chromium in the path: the report is not looked at in a browser")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, args=ARGUMENTS, timeout=1000 * HANGS
        )
        yield browser
        browser.close()


@contextmanager
def opened(browser: Any, file: Path, **context: Any) -> Iterator[Opened]:
    """Open a file offline, and record console, errors and requests."""
    made = browser.new_context(viewport={"width": 1300, "height": 1000}, **context)
    made.set_offline(True)
    made.set_default_timeout(1000 * HANGS)
    found = Opened(made.new_page())
    found.page.on("console", lambda m: found.said.append(f"{m.type}: {m.text}"))
    found.page.on("pageerror", lambda e: found.said.append(f"error: {e}"))
    found.page.on("request", lambda r: found.requests.append(r.url))
    found.page.goto(file.as_uri())
    yield found
    made.close()
