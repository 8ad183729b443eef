"""A browser on the page of a site, with what it said and asked for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from tests.site.canned_server import CannedServer

PHONE, DESK = (390, 844), (1440, 900)
VIEWS = ("overview", "plan", "verdicts", "points", "epochs", "instruments", "downloads", "more")
QUIET = ("Canvas2D: Multiple readback", "GL Driver Message", "Failed to load resource")
"""What Chromium itself says: about plotly, software rendering, and answers that are errors."""


@dataclass
class Visitor:
    """A page in a browser."""

    page: Any
    server: CannedServer
    said: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def go(self, place: str, *, network: str = "small") -> None:
        """Open a view, and wait until it stands."""
        self.page.evaluate("to => { location.hash = to; }", f"#/{network}/{place}")
        self.page.wait_for_selector(f"#view[data-view={place.split('/')[0]}]", state="attached")

    def text(self, selector: str) -> str:
        return str(self.page.locator(selector).first.text_content())

    def sees(self, selector: str, text: str | None = None) -> Any:
        """Wait until an element is seen, and return it."""
        found = self.page.locator(selector)
        if text is not None:
            found = found.filter(has_text=text)
        found.first.wait_for(state="visible")
        return found.first

    def holds(self, script: str, argument: Any = None) -> None:
        """Wait until an expression of JavaScript is true."""
        self.page.wait_for_function(script, arg=argument)

    def press(self, name: str, *, within: str = "body") -> None:
        """Click on the button with this name."""
        self.page.locator(within).get_by_role("button", name=name).first.click()

    @property
    def complaints(self) -> list[str]:
        return [s for s in self.said if not s.startswith(QUIET)]


@contextmanager
def visit(
    browser: Any,
    server: CannedServer,
    *,
    size: tuple[int, int] = DESK,
    language: str = "en-GB",
    scheme: str = "light",
    at: str = "",
    wait: bool = True,
    blank: bool = False,
) -> Iterator[Visitor]:
    """Open the page in a context of its own; ``blank``: the visitor opens it."""
    phone = size == PHONE
    context = browser.new_context(
        viewport={"width": size[0], "height": size[1]},
        locale=language,
        color_scheme=scheme,
        has_touch=phone,
        is_mobile=phone,
        device_scale_factor=2 if phone else 1,
        accept_downloads=True,
    )
    context.set_default_timeout(60_000)
    page = context.new_page()
    found = Visitor(page, server)
    page.on("console", lambda m: found.said.append(m.text))
    page.on("pageerror", lambda e: found.said.append(f"error {e}"))
    page.on("request", lambda r: found.requests.append(r.url))
    if not blank:
        page.goto(server.url + at)
    if wait and not blank:
        page.wait_for_selector("html[data-ready]", state="attached")
        page.wait_for_selector("h1")
    try:
        yield found
    finally:
        context.close()
