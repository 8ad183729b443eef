"""Messages about alarms: by e-mail (SMTP), to a webhook, to a topic of MQTT; sent until they are.

The rows of ``notices`` are written by the transaction that raises or clears an alarm, so that a
message is never lost and never sent for an alarm that is not recorded. One that cannot be sent is
tried again after 5 s, 10 s, 20 s … at most an hour, and given up after three days, which is told.
What is told and noted of a message that fails has no password and no path of a webhook.

    [smtp]
    host = "mail.example.org"
    port = 587
    security = "starttls"        # or "tls", or "none" for a server on this machine
    user = "site"
    password_env = "SITE_SMTP_PASSWORD"
    sender = "site@example.org"
"""

from __future__ import annotations

import json
import os
import smtplib
import ssl
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from email.message import EmailMessage
from pathlib import Path
from threading import Event, Thread
from typing import Any
from urllib.error import URLError
from urllib.parse import unquote, urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from ..errors import AdjustmentError, InputError, Problem
from ..io.csv_tables import row_of_table
from .alarm_log import EPOCH_SECONDS
from .alarm_tables import check_address, shown_address
from .database import Database, DatabaseAway

WATCH_SECONDS = 0.5
"""Time between two looks for messages that are due, seconds."""
TIMEOUT_SECONDS = 20.0
"""Time that a server has to take a message, seconds."""
FIRST_RETRY, MAX_RETRY = 5.0, 3600.0
"""Time until a message is tried again: doubled each time, seconds."""
GIVEN_UP_AFTER = 3.0 * 86400.0
"""Age of a message that is given up, seconds."""
SECURITY = ("starttls", "tls", "none")
"""How the connection to a mail server is secured."""
PORTS = {"starttls": 587, "tls": 465, "none": 25}
"""Ports by security where none is stated."""

Answer = dict[str, Any]


@dataclass(frozen=True)
class MailServer:
    """The mail server of [smtp]."""

    host: str
    """Its name."""
    port: int
    """Its port."""
    security: str
    """One of `SECURITY`."""
    sender: str
    """Address of the sender."""
    user: str = ""
    """User; empty: none."""
    password_env: str = ""
    """Environment variable that holds the password."""


def read_mail_server(table: object, where: str) -> MailServer | None:
    """Return the mail server of a site file; None: none is stated.

    Raises:
        InputError: all problems of the table.
    """
    if table is None:
        return None
    problems: list[Problem] = []
    row = row_of_table(table, "smtp", where, problems)
    if row is None:
        raise InputError(problems)
    host = row.text("host", required=True) or ""
    security = row.choice("security", SECURITY, "starttls")
    port = row.whole("port", least=1, most=65535)
    sender = row.text("sender", required=True) or ""
    user, password = row.text("user", default="") or "", row.text("password_env", default="") or ""
    if row.fields.pop("password", None) is not None:
        row.wrong("a password does not belong into a file that is shown: state password_env")
    elif bool(user) != bool(password):
        row.wrong("user and password_env, the variable with the password, belong together")
    row.refuse_left()
    if problems:
        raise InputError(problems)
    at = PORTS[security] if port is None else port
    return MailServer(host, at, security, sender, user, password)


def address_of(target: str) -> str:
    """Return the address that a target names: itself, or that of ``env:NAME``.

    Raises:
        AdjustmentError: the variable is not set.
        InputError: its text is no address.
    """
    if not target.startswith("env:"):
        return target
    name = target.removeprefix("env:")
    if name not in os.environ:
        raise AdjustmentError(f"the environment variable {name} is not set")
    check_address(os.environ[name])
    return os.environ[name]


class _NoRedirects(HTTPRedirectHandler):
    """A message goes to its address and nowhere else."""

    def redirect_request(self, *_: Any, **__: Any) -> None:
        """Follow nothing."""


class AlarmNotices:
    """Sends the messages of a site, in a thread of its own."""

    def __init__(
        self,
        database: Database,
        site: str,
        server: MailServer | None = None,
        *,
        folder: Path = Path(),
        told: Callable[[str], None] = lambda what: None,
    ) -> None:
        """Take the database.

        Args:
            database: the database.
            site: name of the site, which messages state.
            server: the mail server.
            folder: folder of the site file, for files with passwords.
            told: takes a sentence about a message that is given up.
        """
        self._database, self._site, self._server, self._told = database, site, server, told
        self._folder, self._stop = folder, Event()
        self._thread = Thread(target=self._run, name="alarm notices", daemon=True)

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def stop(self) -> None:
        """End; messages that are left are sent when the service begins again."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(TIMEOUT_SECONDS + 5.0)

    def _run(self) -> None:
        while not self._stop.wait(WATCH_SECONDS):
            try:
                for notice in self._due():
                    if self._stop.is_set():
                        return
                    self._try(notice)
            except DatabaseAway:
                continue

    def _due(self) -> list[Any]:
        from sqlalchemy import or_, select

        from .tables import alarms, notices

        now = clock.time()
        quiet = or_(alarms.c.silenced_until.is_(None), alarms.c.silenced_until <= now)
        wanted = (
            select(notices)
            .join(alarms, alarms.c.id == notices.c.alarm)
            .where(notices.c.sent.is_(None), notices.c.due <= now, quiet)
            .order_by(notices.c.due)
            .limit(20)
        )
        with self._database.reading() as connection:
            return [*connection.execute(wanted)]

    def _try(self, notice: Any) -> None:
        """Send a message, or note why it could not be sent."""
        from sqlalchemy import update

        from .tables import notices

        now, problem = clock.time(), ""
        try:
            self.send(notice.target, json.loads(notice.data))
        except Exception as error:
            # Whatever a server or a library says: one message must not stop the others.
            said = self._without_secrets(" ".join(str(error).split()), notice.target)
            problem = f"{type(error).__name__}: {said[:200]}"
        values: Answer = {"tries": notice.tries + 1, "problem": problem or None}
        if not problem:
            values["sent"] = now
        elif now - notice.created > GIVEN_UP_AFTER:
            values |= {"due": None}
            at = shown_address(notice.target)
            self._told(f"alarm {notice.alarm}: {at} was not told: {problem}")
        else:
            values["due"] = now + min(FIRST_RETRY * 2.0**notice.tries, MAX_RETRY)
        with self._database.writing() as connection:
            connection.execute(update(notices).where(notices.c.id == notice.id).values(**values))

    def _without_secrets(self, text: str, target: str) -> str:
        """Return what an error says without passwords, and without what follows a host."""
        address, secrets = os.environ.get(target.removeprefix("env:"), target), set[str]()
        if self._server is not None and self._server.password_env:
            secrets.add(os.environ.get(self._server.password_env, ""))
        if address.startswith("http"):
            parts = urlsplit(address)
            secrets |= {address, parts.path, parts.query, *parts.path.split("/")}
        for secret in sorted(secrets, key=len, reverse=True):
            text = text.replace(secret, "…") if len(secret) > 3 else text
        return text

    # -- ways to send -----------------------------------------------------------------------------

    def send(self, target: str, alarm: Answer) -> None:
        """Send a message about an alarm.

        Raises:
            Exception: whatever the server says.
        """
        target = address_of(target)
        scheme = urlsplit(target).scheme
        if scheme == "mailto":
            self._mail(target, alarm)
        elif scheme in ("http", "https"):
            self._post(target, alarm)
        else:
            from ..instruments.mqtt import mqtt_address, publish

            publish(mqtt_address(target, self._folder), self._text(alarm))

    def _text(self, alarm: Answer) -> bytes:
        return json.dumps({"site": self._site, "alarm": alarm}, ensure_ascii=False).encode()

    def _mail(self, target: str, alarm: Answer) -> None:
        server = self._server
        if server is None:
            raise AdjustmentError("the site file has no [smtp]")
        message = EmailMessage()
        message["From"] = server.sender
        message["To"] = unquote(urlsplit(target).path)
        message["Subject"] = subject_of(self._site, alarm)
        message.set_content(body_of(alarm))
        context = ssl.create_default_context()
        if server.security == "tls":
            connection: smtplib.SMTP = smtplib.SMTP_SSL(
                server.host, server.port, timeout=TIMEOUT_SECONDS, context=context
            )
        else:
            connection = smtplib.SMTP(server.host, server.port, timeout=TIMEOUT_SECONDS)
        with connection:
            if server.security == "starttls":
                connection.starttls(context=context)
            if server.user:
                password = os.environ.get(server.password_env)
                if password is None:
                    what = f"the environment variable {server.password_env} is not set"
                    raise AdjustmentError(what)
                connection.login(server.user, password)
            connection.send_message(message)

    def _post(self, target: str, alarm: Answer) -> None:
        headers = {"Content-Type": "application/json"}
        request = Request(target, self._text(alarm), headers, method="POST")
        try:
            with build_opener(_NoRedirects).open(request, timeout=TIMEOUT_SECONDS) as answer:
                answer.read(1024)
        except URLError as error:
            raise ConnectionError(str(error)) from None


def subject_of(site: str, alarm: Answer) -> str:
    """Return the subject of a message, on one line."""
    what = "cleared" if alarm["state"] == "closed" else "ALARM"
    places = ", ".join(alarm["points"]) or alarm["network"] or site
    return " ".join(f"{what}: {alarm['rule']}, {places} ({site})".split())


def _utc(time: float) -> str:
    return clock.strftime("%Y-%m-%d %H:%M:%S UTC", clock.gmtime(time))


def _of_epoch(alarm: Answer, name: str) -> str:
    """Return a time of an alarm; that of an epoch is its middle, and its bounds are told."""
    if alarm.get(EPOCH_SECONDS) is None:
        return _utc(alarm[name])
    half = 0.5 * alarm[EPOCH_SECONDS]
    return f"the epoch from {_utc(alarm[name] - half)} to {_utc(alarm[name] + half)}"


def _since(alarm: Answer) -> str:
    """Return since when an alarm stands, with the number of the epoch that raised it."""
    number = alarm.get("epoch")
    return _of_epoch(alarm, "since") + ("" if number is None else f" (epoch {number})")


def body_of(alarm: Answer) -> str:
    """Return the text of a message."""
    lines = [alarm.get("text", ""), "", f"rule: {alarm['rule']}", f"network: {alarm['network']}"]
    lines += [f"points: {', '.join(alarm['points']) or '-'}", f"since: {_since(alarm)}"]
    if alarm["until"] is not None:
        lines.append(f"cleared: {_of_epoch(alarm, 'until')}")
    for key in ("value", "limit", "size_mm", "false_alarms_per_month"):
        if alarm.get(key) is not None:
            lines.append(f"{key.replace('_', ' ')}: {alarm[key]:g}")
    return "\n".join(lines) + "\n"
