"""What comes to a site at random: requests to all routes, lines of all instruments."""

from __future__ import annotations

import sys

import pytest

from factorgraph_adj.site.api import application
from factorgraph_adj.site.site import Site
from factorgraph_adj.site.site_file import read_site
from tests.networks.yard import ARRIVALS
from tests.support.api_fuzz import ENDLESS, ApiFuzz
from tests.support.damaged_lines import LINES
from tests.support.line_fuzz import fuzz_lines
from tests.support.sites import yard_of, yard_site

EXAMPLES = 6
"""Requests to each route."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    made = Site(read_site(yard_site(tmp_path_factory.mktemp("fuzzed"))))
    made.start()
    for record in ARRIVALS:
        assert yard_of(made).submit(record).result(60)["ok"]
    yield made
    made.stop()


@pytest.mark.filterwarnings("ignore")
def test_every_route_answers_as_its_document_says(site):
    fuzz = ApiFuzz(site, seed=1)
    asked = fuzz.ask(EXAMPLES * len(fuzz.routes))
    paths = application(site, lifespan=False).openapi()["paths"]
    every = {(m.upper(), p) for p, methods in paths.items() for m in methods if p != ENDLESS}
    assert {(m.upper(), p) for m, p in asked.routes} == every and len(every) > 25
    assert not asked.faults
    assert {200, 401, 403, 404, 422} <= asked.statuses.keys()


@pytest.mark.parametrize("token", ["", "a b", "é", "a\n", "x" * 201])
def test_a_token_that_is_none_gets_no_cookie(site, token):
    from fastapi.testclient import TestClient

    client = TestClient(application(site, lifespan=False))
    assert client.post("/api/v1/session", json={"token": token}).status_code in (401, 422)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from /proc")
def test_a_site_stays_up_under_hostile_lines_and_tells_them(tmp_path):
    found = fuzz_lines(tmp_path, lines=60, flood=1_500_000, seed=1)
    assert found.lines > 50 * len(LINES)  # some are blank
    assert found.refused > found.lines // 3
