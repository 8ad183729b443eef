"""The API of a site: postings, what is shown, errors, tokens and roles."""

from __future__ import annotations

from json import dumps

import jsonschema
import pytest
from scipy.stats import chi2

import factorgraph_adj as fga
from factorgraph_adj.site.access import Access, TooFast
from factorgraph_adj.site.database import Database
from tests.networks.yard import ARRIVALS, WRONG
from tests.support.sites import ADDRESS, database_of, served

pytestmark = pytest.mark.usefixtures("store")
ROLES = ("instrument", "viewer", "surveyor", "admin")


@pytest.fixture
def client(tmp_path):
    with served(tmp_path) as client:
        yield client


@pytest.fixture
def yard(client):
    answers = client.post(f"{ADDRESS}/postings", json=list(ARRIVALS)).json()
    assert all(a["ok"] for a in answers)
    return client


def test_the_site_says_what_it_has_and_what_the_caller_may(client):
    site = client.get("/api/v1/site").json()
    assert (site["name"], site["role"], site["tokens"]) == ("Yard", "admin", False)
    assert site["networks"][0]["units"]["sigma_length"] == "mm"


def test_a_posting_gets_its_verdict(yard):
    answer = yard.post(f"{ADDRESS}/postings", json=WRONG).json()
    assert (answer["ok"], answer["verdict"], answer["epoch"]) == (True, "rejected", 1)
    rejected = yard.get(f"{ADDRESS}/observations", params={"state": "rejected"}).json()
    assert [o["id"] for o in rejected["rows"]] == ["s3"]


def test_a_request_that_ends_an_epoch_ends_no_other_one(yard):
    """Its answer may be lost, and the next epoch begin before it is tried again."""
    asked = {"close": True, "request": "end-1"}
    first = yard.post(f"{ADDRESS}/epochs", json=asked).json()
    assert (first["number"], first["state"]) == (1, "closed") and first["result"]["converged"]
    assert yard.post(f"{ADDRESS}/postings", json=ARRIVALS[0]).json()["epoch"] == 2
    again = yard.post(f"{ADDRESS}/epochs", json=asked).json()
    assert again == first | {"repeated": True}
    assert [e["state"] for e in yard.get(f"{ADDRESS}/epochs").json()] == ["closed", "open"]
    posted = {**ARRIVALS[1], "request": "end-1"}
    (listed,) = yard.post(f"{ADDRESS}/postings", json=[posted]).json()
    assert listed["conflict"]
    alone = yard.post(f"{ADDRESS}/postings", json=posted)
    assert (alone.status_code, alone.json()["error"]) == (409, listed["error"])
    taken = yard.post(f"{ADDRESS}/postings", json={**posted, "request": "reading"}).json()
    assert taken["ok"]
    ends = yard.post(f"{ADDRESS}/epochs", json={"close": True, "request": "reading"})
    assert ends.status_code == 409 and yard.get(f"{ADDRESS}/epochs").json()[-1]["state"] == "open"


def test_an_epoch_has_the_bounds_of_its_global_test(yard):
    yard.post(f"{ADDRESS}/epochs", json={"close": True})
    (row,) = yard.get(f"{ADDRESS}/epochs").json()
    lower, upper = row["sigma0_limits"]
    r = row["redundancy"]
    assert [lower**2 * r, upper**2 * r] == pytest.approx(chi2.ppf([0.025, 0.975], r))
    assert yard.get(f"{ADDRESS}/epochs/1").json()["sigma0_limits"] == [lower, upper]
    assert yard.get(ADDRESS).json()["sigma0_limits"] == [lower, upper]


def test_points_have_ellipses(yard):
    points = {p["name"]: p for p in yard.get(f"{ADDRESS}/points").json()}
    assert points["C"]["determined"] and points["C"]["object"] and not points["A"]["object"]
    ellipse = points["C"]["ellipse"]
    assert ellipse["a_mm"] > ellipse["b_mm"] > 0.0


def test_observations_come_in_pages(yard):
    first = yard.get(f"{ADDRESS}/observations", params={"limit": 4}).json()
    rest = yard.get(f"{ADDRESS}/observations", params={"limit": 4, "after": first["next"]}).json()
    ids = [o["id"] for page in (first, rest) for o in page["rows"]]
    assert sorted(ids) == sorted(a["id"] for a in ARRIVALS)
    assert rest["next"] is None and first["total"] == 7


@pytest.mark.parametrize("name", ["report.html", "results.json", "network.gpkg", "project.zip"])
def test_downloads_are_whole_files(yard, name):
    answer = yard.get(f"{ADDRESS}/{name}")
    assert answer.status_code == 200 and len(answer.content) > 500
    assert "attachment" in answer.headers["content-disposition"]


def test_a_report_says_of_what_it_is_and_what_is_left_out(yard):
    wrong = [WRONG, {**WRONG, "id": "s4", "value": 70.4}]
    answers = yard.post(f"{ADDRESS}/postings", json=wrong).json()
    assert [a["verdict"] for a in answers] == ["rejected"] * 2
    subject = "Yard, network yard, epoch 1 (20"
    page = yard.get(f"{ADDRESS}/report.html").text
    assert f"<title>Adjustment of {subject}" in page
    assert "no indication of gross errors" not in page
    assert "2 readings are not in this adjustment." in page
    results = yard.get(f"{ADDRESS}/results.json").json()
    assert results["run"]["subject"].startswith(subject)
    jsonschema.validate(results, fga.results_schema())
    told = [n for n in results["notes"] if n.startswith("left out (rejected): ")]
    assert len(told) == 2
    assert all(f"{n} mm, σ " in t for n, t in zip(("-187", "313"), told, strict=True)), told
    listed = page.split("Readings that are left out")[1]
    assert "B C (id s3)" in listed and "B C (id s4)" in listed


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("get", "/api/v1/networks/none", 404),
        ("get", f"{ADDRESS}/epochs/99", 404),
        ("get", f"{ADDRESS}/stop", 404),
        ("get", f"{ADDRESS}/observations?state=none", 422),
        ("get", f"{ADDRESS}/observations?limit=0", 422),
        ("get", f"{ADDRESS}/covariance?points=NOWHERE", 422),
        ("get", f"{ADDRESS}/report.html", 422),
        ("get", "/api/v1/nothing", 404),
        ("put", "/api/v1/site", 405),
    ],
)
def test_errors_say_what_is_wrong(client, method, path, status):
    answer = getattr(client, method)(path)
    assert answer.status_code == status
    assert answer.json()["error"][0]["what"]


def test_a_mistyped_parameter_is_refused(client):
    answer = client.get(f"{ADDRESS}/covariance?poinst=C&points=C&format=json")
    assert answer.status_code == 422
    problems = {p["where"]: p["what"] for p in answer.json()["error"]}
    assert problems.keys() == {"poinst", "format"}
    assert problems["poinst"].endswith("; did you mean 'points'?")


@pytest.mark.parametrize(
    ("posting", "parts"),
    [
        ({"type": "slope_distence", "station": "A"}, ("kind", '"kind": "slope_distance" for ')),
        ({"kind": "slope_distence"}, ("unknown kind", "; did you mean 'slope_distance'?")),
        ({"do": "setle"}, ("unknown command 'setle'; valid: accept, ", "did you mean 'settle'?")),
        ({"do": ["settle"]}, ("unknown command ['settle']; valid: accept, ",)),
    ],
)
def test_a_mistyped_posting_is_asked_for_what_was_meant(client, posting, parts):
    answer = client.post(f"{ADDRESS}/postings", json=posting)
    assert answer.status_code == 200
    (problem,) = answer.json()["error"]
    assert all(part in problem["what"] for part in parts), problem
    assert len(problem["what"]) < 700


def test_an_epoch_that_is_not_there_is_answered_with_those_that_are(client):
    (problem,) = client.get(f"{ADDRESS}/epochs/99").json()["error"]
    assert "has no epoch 99; its latest: " in problem["what"]


def test_every_route_needs_its_right(tmp_path):
    with served(tmp_path) as client:
        site = client.app.state.site
        tokens = {role: site.access.add(role, role) for role in ROLES}
        wanted = {
            ("get", "/api/v1/site"): "read",
            ("get", "/api/v1/events"): "read",
            ("get", "/api/v1/tokens"): "manage",
            ("post", "/api/v1/tokens"): "manage",
            ("delete", "/api/v1/tokens/{token}"): "manage",
            ("post", f"{ADDRESS}/postings"): "post",
            ("post", f"{ADDRESS}/epochs"): "decide",
            ("post", "/api/v1/alarms/{alarm}/acknowledge"): "decide",
            ("post", "/api/v1/alarms/{alarm}/silence"): "decide",
        }
        public = {"/api/v1/health", "/api/v1/session", "/api/v1/openapi.json"}
        public |= {"/", "/page/plotly.min.js"}
        # Of the application itself, so that a route is asked whether it is documented or not.
        paths = {*_routes(client.app.routes)}
        documented = client.get("/api/v1/openapi.json").json()["paths"]
        assert {(m, p) for p, methods in documented.items() for m in methods} <= paths
        for method, path in sorted(paths):
            if path in public or method == "head":
                continue
            own = path.replace("{name}", "yard") if "/networks/" in path else path
            # What changes something states its right here.
            right = wanted.pop((method, own), "read" if method == "get" else "not stated")
            _check(client, tokens, method, own, right)
        assert not wanted
        for path in ("/api/v1/networks/none", "/api/v1/networks/none/points"):
            answer = client.get(path)  # strangers do not learn which networks there are
            assert answer.status_code == 401 and "yard" not in answer.text


def _routes(routes, before=""):
    """Yield methods and paths of all routes; the files of the page are none."""
    for route in routes:
        if (inside := getattr(route, "original_router", None)) is not None:
            yield from _routes(inside.routes, before + route.include_context.prefix)
        elif route.path != "/page":
            for method in route.methods:  # a route without methods is tested nowhere else either
                yield method.lower(), before + route.path


def _check(client, tokens, method, path, right):
    from factorgraph_adj.site.access import RIGHTS

    path = path.replace("{number}", "1").replace("{token}", "99").replace("{alarm}", "99")
    assert client.request(method, path).status_code == 401, path
    wrong = {"Authorization": "Bearer fga_wrong"}
    assert client.request(method, path, headers=wrong).status_code == 401, path
    for role, token in tokens.items():
        if right in RIGHTS[role] and path.endswith("/events"):
            continue  # it never ends
        headers = {"Authorization": f"Bearer {token}"}
        status = client.request(method, path, headers=headers).status_code
        assert (status == 403) == (right not in RIGHTS[role]), (method, path, role, status)


def test_an_instrument_may_post_readings_but_not_decide(tmp_path):
    with served(tmp_path) as client:
        token = client.app.state.site.access.add("ts1", "instrument")
        client.headers["Authorization"] = f"Bearer {token}"
        assert client.post(f"{ADDRESS}/postings", json=ARRIVALS[0]).json()["ok"]
        answer = client.post(f"{ADDRESS}/postings", json={"do": "remove", "ids": ["r1"]})
        assert answer.status_code == 403
        assert client.get(f"{ADDRESS}/points").status_code == 403


def test_a_browser_logs_in_with_a_cookie_and_a_revoked_token_ends_it(tmp_path):
    with served(tmp_path) as client:
        access = client.app.state.site.access
        token = access.add("office", "viewer")
        assert client.get("/api/v1/site").status_code == 401
        assert client.post("/api/v1/session", json={"token": "no"}).status_code == 401
        cookie = client.post("/api/v1/session", json={"token": token}).headers["set-cookie"]
        assert "HttpOnly" in cookie and "SameSite=strict" in cookie
        assert client.get("/api/v1/site").json()["role"] == "viewer"
        access.revoke(access.listed()[0]["id"])
        assert client.get("/api/v1/site").status_code == 401


def test_somebody_can_always_make_tokens(tmp_path):
    with served(tmp_path) as client:

        def made(name, role, **more):
            return client.post("/api/v1/tokens", json={"name": name, "role": role, **more})

        for role, more in (("viewer", {}), ("admin", {"days": 3.0})):
            answer = made("first", role, **more)
            assert answer.status_code == 422
            assert "the first token must be that of an admin" in answer.json()["error"][0]["what"]
        assert client.get("/api/v1/site").json()["tokens"] is False
        client.headers["Authorization"] = f"Bearer {made('boss', 'admin').json()['token']}"
        assert made("office", "viewer").status_code == made("guest", "admin", days=3.0).status_code
        ids = {t["name"]: t["id"] for t in client.get("/api/v1/tokens").json()}
        last = client.delete(f"/api/v1/tokens/{ids['boss']}")
        assert last.status_code == 422 and "make another first" in last.json()["error"][0]["what"]
        assert made("deputy", "admin").status_code == 200
        assert client.delete(f"/api/v1/tokens/{ids['boss']}").status_code == 200


def test_a_body_that_is_too_large_is_refused(client):
    answer = client.post(f"{ADDRESS}/postings", content=b"[" + b" " * (17 << 20) + b"]")
    assert answer.status_code == 413


def test_a_body_in_chunks_that_is_too_large_is_refused(client):
    chunks = (b" " * (1 << 20) for _ in range(17))
    headers = {"Content-Type": "application/json"}
    answer = client.post(f"{ADDRESS}/postings", content=chunks, headers=headers)
    assert "content-length" not in answer.request.headers
    assert answer.status_code == 413 and "16 MB" in answer.json()["error"][0]["what"]


def test_requests_are_limited_for_each_token_and_not_without_tokens(tmp_path):
    database = Database(database_of(tmp_path), serve=False)
    access = Access(database, per_second=0.1)  # one at once, the next one after ten seconds
    for _ in range(100):
        access.slow_down(access.caller(None))
    callers = [access.caller(access.add(name, "instrument")) for name in ("a", "b")]
    for caller in callers:
        access.slow_down(caller)
        with pytest.raises(TooFast, match=f"{caller.name} makes more than 0.1 requests a second"):
            access.slow_down(caller)
    database.close()


def test_answers_carry_a_policy_for_the_browser(client):
    headers = client.get("/api/v1/site").headers
    assert "default-src 'self'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"


LARGE = 10**30
"""Number that no column of a database holds."""


@pytest.mark.parametrize(
    ("method", "path", "json"),
    [
        ("POST", f"/api/v1/alarms/{LARGE}/acknowledge", None),
        ("POST", f"/api/v1/alarms/-{LARGE}/acknowledge", None),
        ("POST", f"/api/v1/alarms/{LARGE}/silence", {"hours": 1}),
        ("DELETE", f"/api/v1/tokens/{LARGE}", None),
        ("GET", f"/api/v1/events?after={LARGE}", None),
        ("GET", f"{ADDRESS}/epochs/{LARGE}", None),
        ("GET", f"{ADDRESS}/epochs/{2**31}", None),
        ("GET", f"{ADDRESS}/report.html?epoch={LARGE}", None),
        ("GET", f"{ADDRESS}/rejected?epoch={LARGE}", None),
        ("GET", f"{ADDRESS}/observations?state=accepted&epoch={LARGE}", None),
    ],
)
def test_a_number_that_the_database_cannot_hold_is_refused(yard, method, path, json):
    answer = yard.request(method, path, json=json)
    assert answer.status_code == 422 and answer.json()["error"][0]["what"], answer.text


def test_an_alarm_of_a_point_that_no_table_can_hold_is_none(yard):
    answer = yard.get("/api/v1/alarms", params={"point": "a\0b"})
    assert answer.status_code in (200, 422)
    assert answer.json() == [] or answer.json()["error"]


@pytest.mark.parametrize("odd", ["a\0b", "a\ud800b", "a\u202eb"])
def test_texts_that_no_database_or_file_can_hold_refuse_their_posting_alone(yard, odd):
    """Others that come in the same transaction are taken."""
    good = {"kind": "height_difference", "station": "A", "target": "C", "value": 1.4996}
    odd_ones = [
        *({**good, "id": "r", "request": odd}, {**good, "id": odd}, {**good, "station": odd}),
        {**good, "measured": {"instrument": odd, "begin": 1.0, "end": 2.0}},
        *({**good, "id": "t", "time": LARGE}, {"do": "solution", "epoch": LARGE}),
        {"do": "close epoch", "epoch": 10**400},
    ]
    both = [p for n, o in enumerate(odd_ones) for p in (o, {**good, "id": f"good{n}"})]
    raw = dumps(both)  # as the client that tests have would not send them
    answer = yard.post(
        f"{ADDRESS}/postings", content=raw, headers={"Content-Type": "application/json"}
    )
    assert answer.status_code == 200, answer.text
    for n, (refused, taken) in enumerate(zip(*[iter(answer.json())] * 2, strict=True)):
        assert not refused["ok"] and refused["error"][0]["what"], (n, refused)
        assert taken["ok"], (n, taken)
    ids = [o["id"] for o in yard.get(f"{ADDRESS}/observations?state=accepted").json()["rows"]]
    assert {f"good{n}" for n in range(len(odd_ones))} <= {*ids}


@pytest.mark.parametrize("odd", ["a\0b", "a\ud800b"])
def test_a_token_has_a_name_that_a_table_can_hold(client, odd):
    admin = client.post("/api/v1/tokens", json={"name": "chief", "role": "admin"}).json()
    said = {"Content-Type": "application/json", "Authorization": f"Bearer {admin['token']}"}
    raw = dumps({"name": odd, "role": "viewer"})
    answer = client.post("/api/v1/tokens", content=raw, headers=said)
    assert answer.status_code == 422
    assert "control characters" in answer.json()["error"][0]["what"]


def test_a_body_that_is_said_to_be_something_else_is_told_how_to_be_sent(yard):
    """As curl sends it where nothing is stated."""
    said = {"Content-Type": "application/x-www-form-urlencoded"}
    answer = yard.post(f"{ADDRESS}/postings", content=dumps(ARRIVALS[0]), headers=said)
    assert answer.status_code == 422
    assert "Content-Type: application/json" in answer.json()["error"][0]["what"]


def test_files_of_an_ended_epoch_have_names_of_their_own(yard):
    yard.post(f"{ADDRESS}/epochs", json={"close": True})
    for file, name in (("report.html", "yard-epoch-1.html"), ("project.zip", "yard-epoch-1.zip")):
        answer = yard.get(f"{ADDRESS}/{file}", params={"epoch": 1})
        assert f'filename="{name}"' in answer.headers["Content-Disposition"]
