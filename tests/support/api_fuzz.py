"""Requests to all routes of a site by its OpenAPI document, of callers with all roles.

Half of the requests are what the document allows, half are not; postings are also objects of the
stream protocol with fields that are none. A fault is an answer of 500 or more, and one that is not
as the document says: its status, its media type or its content.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from requests.exceptions import InvalidJSONError
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import Failure, FailureGroup
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from factorgraph_adj.site.access import RIGHTS
from factorgraph_adj.site.api import application
from factorgraph_adj.site.site import Site
from tests.networks.yard import ARRIVALS

ENDLESS = "/api/v1/events"
"""The route whose answer never ends."""
CHECKS = (
    *(not_a_server_error, status_code_conformance, content_type_conformance),
    response_schema_conformance,
)
STRANGERS = ("nobody", "stranger")
"""Callers without a token, and with one that is unknown."""
DOINGS = (
    *("add", "remove", "replace", "accept", "discard", "causes", "doubts", "reliability", "settle"),
    *("next_sights", "estimates", "points", "none", "network", "proposals", "quit", "help", ""),
)
ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([0, -1, 1 << 70, 1e308, -1e308, 5e-324, math.nan, math.inf]),
    st.floats(allow_nan=False),
    st.text(max_size=20),
    st.sampled_from(["A", "B", "C", "NOWHERE", "s1", "\0", "\ud800", "A" * 5000]),
    st.lists(st.sampled_from(["A", "s1", 1, None, {}]), max_size=3),
    st.dictionaries(st.text(max_size=5), st.integers(), max_size=2),
)
"""Values that a field may come with."""


@dataclass
class Asked:
    """What was asked, and what was answered."""

    routes: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Number of requests to each route."""
    statuses: Counter[int] = field(default_factory=Counter)
    """Number of answers by their status."""
    roles: Counter[str] = field(default_factory=Counter)
    """Number of requests of each caller."""
    faults: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    """Method, path and what was wrong."""


@st.composite
def odd_postings(draw: st.DrawFn) -> Any:
    """Return postings with fields of the protocol that are wrong, missing or odd."""
    record: dict[str, Any] = dict(draw(st.sampled_from(ARRIVALS)))
    if draw(st.booleans()):
        record = {"do": draw(st.sampled_from(DOINGS))}
    names = ("kind", "station", "target", "value", "time", "request", "id", "ids", "do", "sigma")
    names += ("points", "most", "observations", "sigma_mm", "set", "stations", "remark", "new")
    for name in draw(st.lists(st.sampled_from(names), max_size=3)):
        record[name] = draw(ODD)
    if record and draw(st.integers(0, 9)) == 0:
        record.pop(draw(st.sampled_from(sorted(record))))
    return draw(st.sampled_from([record, [record], [record, {}, record]]))


class ApiFuzz:
    """A site whose routes are asked."""

    def __init__(self, site: Site, *, seed: int) -> None:
        """Take a site that runs; it gets tokens, and its callers no limit of rate."""
        self.site, self.seed, self.asked = site, seed, Asked()
        self._rng = random.Random(seed)
        self.tokens = {role: site.access.add(f"{role} {seed}", role) for role in RIGHTS}
        site.access.per_second = 1e9
        app = application(site, lifespan=False)
        schema = schemathesis.openapi.from_asgi("/api/v1/openapi.json", app)
        found = [f.ok() for f in schema.get_all_operations()]
        self.routes = [r for r in found if r.path != ENDLESS]

    def headers(self, role: str) -> dict[str, str]:
        """Return what a caller sends of itself."""
        if role == "nobody":
            return {}
        if role == "stranger":
            return {"Authorization": "Bearer fga_unknown"}
        access = self.site.access
        if not any(t["name"] == f"{role} {self.seed}" for t in access.listed()):  # was revoked
            self.tokens[role] = access.add(f"{role} {self.seed}", role)
        return {"Authorization": f"Bearer {self.tokens[role]}"}

    def ask(self, examples: int) -> Asked:
        """Ask all routes, about as many times together."""
        each = math.ceil(examples / len(self.routes))
        for number, route in enumerate(self.routes):
            self._ask(route, each, number)
        return self.asked

    def _ask(self, route: Any, examples: int, number: int) -> None:
        strategies = [route.as_strategy(), route.as_strategy(GenerationMode.NEGATIVE)]
        if route.path.endswith("/postings"):
            bodies = odd_postings()
            strategies.append(st.builds(self._posting, route.as_strategy(), bodies))

        @seed(1000 * self.seed + number)
        @settings(
            max_examples=examples,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            phases=[Phase.generate],
            database=None,
        )
        @given(case=st.one_of(strategies))
        def ask(case: Any) -> None:
            self._send(route, case)

        ask()

    @staticmethod
    def _posting(case: Any, body: Any) -> Any:
        case.body = body
        return case

    def _send(self, route: Any, case: Any) -> None:
        # Few strangers: most requests are to reach the route.
        roles = (*RIGHTS, "admin", "admin", "surveyor", *STRANGERS)
        role = self._rng.choice(roles)
        if "/networks/" in route.path and self._rng.random() < 0.75:
            case.path_parameters["name"] = "yard"
        self.asked.routes[route.method, route.path] += 1
        self.asked.roles[role] += 1
        try:
            answer = case.call(headers=self.headers(role))
        except (UnicodeEncodeError, ValueError, InvalidJSONError) as error:  # no client can send it
            if "encode" not in str(error) and "JSON" not in str(error):
                self._note(route, 500, error)
            return
        except Exception as error:
            self._note(route, 500, error)
            return
        self.asked.statuses[answer.status_code] += 1
        try:
            case.validate_response(answer, checks=list(CHECKS))
        except (Failure, FailureGroup) as error:
            parts = getattr(error, "exceptions", (error,))
            self._note(route, answer.status_code, *parts)

    def _note(self, route: Any, status: int, *errors: Exception) -> None:
        """Note what was wrong with an answer; what the service raised is one of 500."""
        said = "; ".join(f"{type(e).__name__}: {str(e).splitlines()[0]}"[:200] for e in errors)
        self.asked.faults[route.method, route.path, f"{status} {said}"] += 1
