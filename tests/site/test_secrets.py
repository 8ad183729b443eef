"""No secret of a site is in what it prints, keeps, answers or archives.

The site is a process with logs of all libraries at DEBUG. Its mail server, webhooks and broker
refuse; its callers come with wrong tokens, and with tokens where they do not belong.
"""

from __future__ import annotations

import base64
import os
import socket
import subprocess
import sys
import zipfile
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import httpx2
import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.site.alarm_tables import check_address, read_alarms, shown_address
from factorgraph_adj.site.database import Database
from factorgraph_adj.site.site_archive import write_archive
from tests.networks.yard import ARRIVALS
from tests.support.places import ROOT
from tests.support.processes import HANGS
from tests.support.site_processes import SiteProcess
from tests.support.sites import ADDRESS, database_of, until, yard_site

SECRETS = {
    "mail": "mail-S3cret-77",
    "broker": "broker-S3cret-78",
    "hook": "hook-S3cret-79",
    "key": "key-S3cret-80",
    "bearer": "fga_wrong-S3cret-81",
    "query": "fga_query-S3cret-82",
    "cookie": "fga_cookie-S3cret-83",
}
DEBUG_LOGS = "import logging\nlogging.basicConfig(level=logging.DEBUG)\n"
"""Logs of all libraries go to standard error, whatever they say."""
MORE = """
[smtp]
host = "127.0.0.1"
port = {mail}
security = "none"
user = "site"
password_env = "SITE_SMTP_PASSWORD"
sender = "site@example.org"
[[instrument]]
name = "gauge"
network = "yard"
source = "mqtt://site@127.0.0.1:{broker}/levels?password_env=SITE_BROKER_PASSWORD"
grammar = "sensor-lines"
columns = ["T"]
sensors = {{ temperature = "T degC" }}
[[alarm]]
name = "quiet"
network = "yard"
test = "silence"
after = 0.5
notify = [
  "mailto:chief@example.org", "env:SITE_HOOK", "env:SITE_NO_HOOK", "env:SITE_BAD_HOOK",
  "mqtt://site@127.0.0.1:{broker}/alarms?password_env=SITE_BROKER_PASSWORD",
]
"""


@contextmanager
def refusing(*answers: bytes):
    """Give a port whose server answers each line that comes with the next of its answers.

    An answer may repeat the line, as some servers do: ``%s``.
    """
    listening = socket.create_server(("127.0.0.1", 0))

    def serve():
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            with connection, connection.makefile("rwb") as stream:
                for answer in answers:
                    if answer.startswith(b"<"):
                        stream.write(answer[1:])
                    else:
                        line = stream.readline().strip()
                        stream.write(answer.replace(b"%s", line))
                    stream.flush()

    Thread(target=serve, daemon=True).start()
    yield listening.getsockname()[1]
    listening.close()


MAIL = (b"<220 here\r\n", b"250-here\r\n250 AUTH PLAIN\r\n", b"535 no: mail-S3cret-77\r\n")
HOOK = (b"HTTP/1.1 500 no %s\r\nConnection: close\r\n\r\n",)
BROKER = (b"<\x20\x02\x00\x05",)
"""A broker that does not authorise."""


def forms(secret: str) -> set[bytes]:
    """Return a secret as it may stand somewhere."""
    plain = secret.encode()
    login = base64.b64encode(b"\0site\0" + plain)
    return {plain, base64.b64encode(plain), login, base64.b64encode(plain)[:-4]}


def there(where: dict[str, bytes], secrets: list[str]) -> set[tuple[str, str]]:
    """Return which secrets are in which places."""
    return {
        (place, secret)
        for place, data in where.items()
        for secret in secrets
        if any(form in data for form in forms(secret))
    }


def files_of(folder: Path) -> dict[str, bytes]:
    """Return all files of a folder."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def answers_of(url: str, token: str) -> dict[str, bytes]:
    """Return what the API answers: right and wrong requests, and all that can be read."""
    out, headers = {}, {"Authorization": f"Bearer {token}"}
    with httpx2.Client(base_url=url, timeout=HANGS) as client:
        wrong = [
            {"headers": {"Authorization": f"Bearer {SECRETS['bearer']}"}},
            {"params": {"token": SECRETS["query"], "access_token": SECRETS["query"]}},
            {"headers": {"Cookie": f"fga_session={SECRETS['cookie']}"}},
        ]
        for n, options in enumerate(wrong):
            for path in ("/api/v1/site", "/api/v1/events", ADDRESS, "/api/v1/nothing", "/"):
                answer = client.get(path, **options)
                assert answer.status_code in (401, 404) or path == "/"
                out[f"wrong {n} {path}"] = answer.content + str(answer.headers).encode()
        login = client.post("/api/v1/session", json={"token": SECRETS["bearer"]})
        assert login.status_code == 401
        out["login"] = login.content
        for body in (b"{", b"[[[[", b'{"kind": NaN}', b"\xff", b'{"do": "network"}'):
            answer = client.post(f"{ADDRESS}/postings", content=body, headers=headers)
            out[f"posting {body!r}"] = answer.content
        paths = client.get("/api/v1/openapi.json").json()["paths"]
        for path, methods in paths.items():
            if "get" not in methods or path.endswith("/api/v1/events"):
                continue
            own = path.replace("{name}", "yard").replace("{number}", "1")
            found = client.get(own, headers=headers, params={"points": "A,C", "target": "C"})
            assert found.status_code < 500, path
            out[path] = found.content
        alarms = client.get("/api/v1/alarms", headers=headers, params={"state": "all"})
        assert alarms.json()
        with client.stream("GET", "/api/v1/events?after=0", headers=headers) as events:
            text = b""
            for line in events.iter_lines():
                text += line.encode() + b"\n"
                if b"event: beat" in text:
                    break
        assert b"event: alarm" in text and b"event: arrival" in text
        out["events"] = text
    return out


@pytest.mark.usefixtures("store")
def test_no_secret_is_printed_kept_answered_or_archived(tmp_path, monkeypatch):
    folder, tools = tmp_path / "site", tmp_path / "tools"
    folder.mkdir()
    tools.mkdir()
    (tools / "sitecustomize.py").write_text(DEBUG_LOGS)
    path = os.pathsep.join([str(tools), os.environ.get("PYTHONPATH", str(ROOT))])
    with refusing(*MAIL) as mail, refusing(*HOOK) as hook, refusing(*BROKER) as broker:
        address = f"http://127.0.0.1:{hook}/services/{SECRETS['hook']}/T0?key={SECRETS['key']}"
        environment = {
            "PYTHONPATH": path,
            "SITE_SMTP_PASSWORD": SECRETS["mail"],
            "SITE_BROKER_PASSWORD": SECRETS["broker"],
            "SITE_HOOK": address,
            "SITE_BAD_HOOK": f"http://site:{SECRETS['key']}@127.0.0.1:{hook}/{SECRETS['hook']}",
        }
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        site = SiteProcess(yard_site(folder, more=MORE.format(mail=mail, broker=broker)))
        database_of(folder)
        tokens = ["--token", "office:admin", "--token", "ts1:instrument"]
        made = subprocess.run(
            [sys.executable, "-m", "factorgraph_adj", "serve", str(folder), *tokens],
            capture_output=True,
            cwd=ROOT,
            timeout=HANGS,
            check=True,
        )
        tokens = [line.split()[-1] for line in made.stdout.decode().splitlines()]
        assert len(tokens) == 2
        try:
            site.start()
            headers = {"Authorization": f"Bearer {tokens[1]}"}
            for record in ARRIVALS:
                posted = httpx2.post(
                    f"{site.url}{ADDRESS[1:]}/postings", json=record, headers=headers, timeout=HANGS
                )
                assert posted.json()["ok"]
            until(lambda: len(tries_of(folder)) == 5 and all(tries_of(folder).values()), HANGS)
            answers = answers_of(site.url, tokens[0])
            counts = write_archive(folder, tmp_path / "site.zip")
            assert counts["notices"] >= 5
        finally:
            site.end()
    secrets = [*SECRETS.values(), *tokens]
    log = site.log.read_bytes()
    assert b"DEBUG" in log  # the logs are on
    places = {**files_of(folder), **answers, "serve --token": made.stderr}
    with zipfile.ZipFile(tmp_path / "site.zip") as archive:
        places |= {f"archive {n}": archive.read(n) for n in archive.namelist()}
    assert not there(places, secrets)
    problems = tries_of(folder)
    assert "SMTPAuthenticationError: (535, b'no: …')" in problems["mailto:chief@example.org"]
    assert "500" in problems["env:SITE_HOOK"] and "SITE_NO_HOOK" in problems["env:SITE_NO_HOOK"]
    assert "before the host" in problems["env:SITE_BAD_HOOK"]


def tries_of(folder: Path) -> dict[str, str]:
    """Return what is noted of messages that could not be sent, by their targets."""
    from sqlalchemy import select

    from factorgraph_adj.site.tables import notices

    database = Database(database_of(folder), serve=False)
    try:
        with database.reading() as connection:
            rows = connection.execute(select(notices.c.target, notices.c.problem)).all()
        return {r.target: r.problem or "" for r in rows}
    finally:
        database.close()


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("https://hooks.example.org/services/S3cret?key=S3cret", "https://hooks.example.org/…"),
        ("https://S3cret:S3cret@example.org:8443/S3cret", "https://example.org:8443/…"),
        ("http:S3cret", "http:…"),
        ("S3cret-without-a-scheme", "…"),
        ("env:SITE_HOOK", "env:SITE_HOOK"),
        ("mailto:chief@example.org", "mailto:chief@example.org"),
    ],
)
def test_an_address_is_shown_without_its_path(address, shown):
    assert shown_address(address) == shown


@pytest.mark.parametrize(
    "address",
    [
        "https://u:S3cret@example.org/x",
        "https:///S3cret",
        "https://example.org:S3cret/",
        "https://example.org/S3cret x",
        "ftp://example.org/S3cret",
        "env:S3cret-x",
        "mqtt://u:S3cret@h/t",
        "mqtt://h",
        "mailto:",
        "",
    ],
)
def test_what_is_no_address_of_messages_is_refused_without_its_secret(address):
    with pytest.raises(InputError) as by_itself:
        check_address(address)
    alarm = {"name": "a", "test": "silence", "notify": [address]}
    with pytest.raises(InputError) as in_file:
        read_alarms([alarm], where="site.toml", networks=["yard"])
    for refused in (by_itself, in_file):
        assert "S3cret" not in str(refused.value).replace("env:S3cret-x", "")


@pytest.mark.parametrize(
    "address",
    [
        "postgresql+psycopg://site:S3cret@127.0.0.1:9/site",
        "postgresql+psycopg://site@127.0.0.1:9/site?password=S3cret",
        "postgresql+psycopg://site:S3cret@127.0.0.1:port/site",
        "://site:S3cret@127.0.0.1/site",
    ],
)
def test_a_password_in_the_address_of_a_database_is_refused_and_not_shown(tmp_path, address):
    with pytest.raises(InputError) as refused:
        Database(address)
    assert "S3cret" not in str(refused.value)
    folder = yard_site(tmp_path)
    text = (folder / "site.toml").read_text().splitlines()
    text = [f'database = "{address}"' if x.startswith("database") else x for x in text]
    (folder / "site.toml").write_text("\n".join(text))
    for command in (["serve", str(folder), "--port", "0"], ["backup", str(folder), "x.zip"]):
        done = subprocess.run(
            [sys.executable, "-m", "factorgraph_adj", *command],
            capture_output=True,
            cwd=ROOT,
            timeout=HANGS,
        )
        assert done.returncode and b"S3cret" not in done.stdout + done.stderr
