"""The API takes what its OpenAPI document allows, and more, without a fault of its own."""

from __future__ import annotations

import itertools

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings

from factorgraph_adj.site.api import application
from factorgraph_adj.site.site import Site
from factorgraph_adj.site.site_file import read_site
from tests.networks.yard import ARRIVALS
from tests.support.sites import yard_of, yard_site

EXAMPLES = 8
"""Requests to each route."""
ENDLESS = "/api/v1/events"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    made = Site(read_site(yard_site(tmp_path_factory.mktemp("fuzzed"))))
    made.start()
    for record in ARRIVALS:
        assert yard_of(made).submit(record).result(60)["ok"]
    yield made
    made.stop()


@pytest.mark.filterwarnings("ignore")
def test_no_request_is_answered_with_a_fault(site, monkeypatch):
    monkeypatch.setattr(site.access, "slow_down", lambda *_: None)
    app = application(site, lifespan=False)
    schema = schemathesis.openapi.from_asgi("/api/v1/openapi.json", app)
    asked = set()
    for found in schema.get_all_operations():
        if found.ok().path != ENDLESS:
            _ask(found.ok(), asked)
    assert len(asked) > 15


def _ask(route, asked):
    number = itertools.count()

    @seed(1)
    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.generate],
        database=None,
    )
    @given(case=route.as_strategy())
    def ask(case):
        if "/networks/" in route.path and next(number) % 4:
            case.path_parameters["name"] = "yard"
        assert case.call().status_code < 500, (route.method, route.path)
        asked.add((route.method, route.path))

    ask()


@pytest.mark.parametrize("token", ["", "a b", "é", "a\n", "x" * 201])
def test_a_token_that_is_none_gets_no_cookie(site, token):
    from fastapi.testclient import TestClient

    client = TestClient(application(site, lifespan=False))
    assert client.post("/api/v1/session", json={"token": token}).status_code == 422
