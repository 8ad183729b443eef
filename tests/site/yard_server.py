"""The yard as a site on a port, for browsers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

from tests.support.sites import ADDRESS, yard_site
from tests.support.thread_server import ThreadServer


class YardServer(ThreadServer):
    """The service with the yard; what was recorded is there when it is started again."""

    def __init__(self, folder: Path, **options: str) -> None:
        """Write the site, and serve it.

        Args:
            folder: its folder.
            options: see `yard_site`.
        """
        self.folder = yard_site(folder, **options)
        super().__init__()

    def application(self) -> Any:
        from factorgraph_adj.site.api import application
        from factorgraph_adj.site.site import Site
        from factorgraph_adj.site.site_file import read_site

        return application(Site(read_site(self.folder)))

    def post(self, *postings: dict[str, Any]) -> list[dict[str, Any]]:
        """Post, as an instrument does."""
        data = json.dumps(list(postings)).encode()
        address = f"{self.url.rstrip('/')}{ADDRESS}/postings"
        with urlopen(Request(address, data, {"Content-Type": "application/json"})) as answer:
            found: list[dict[str, Any]] = json.load(answer)
        return found
