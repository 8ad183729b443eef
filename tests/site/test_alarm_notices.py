"""Messages about alarms: sent once, tried again, kept back where an alarm is silenced."""

from __future__ import annotations

import json
import socket
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import Thread

import pytest
from sqlalchemy import select

from factorgraph_adj.errors import InputError
from factorgraph_adj.site.alarm_log import AlarmLog, Raised, reconcile
from factorgraph_adj.site.alarm_notices import AlarmNotices, MailServer, read_mail_server
from factorgraph_adj.site.database import Database
from factorgraph_adj.site.tables import notices
from tests.support.sites import until

DATA = {"test": "displacement", "value": 40.1, "limit": 25.2, "text": "C has moved by 10.1 mm"}


@contextmanager
def mail_server():
    """Give the port of a mail server and the messages that it has taken."""
    listening = socket.create_server(("127.0.0.1", 0))
    taken = []

    def serve():
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            with connection, connection.makefile("rwb") as stream:
                stream.write(b"220 here\r\n")
                stream.flush()
                for line in stream:
                    word = line[:4].upper()
                    stream.write(b"354 go\r\n" if word == b"DATA" else b"250 ok\r\n")
                    stream.flush()
                    if word == b"DATA":
                        text = []
                        for part in stream:
                            if part == b".\r\n":
                                break
                            text.append(part)
                        taken.append(b"".join(text).decode())
                        stream.write(b"250 taken\r\n")
                        stream.flush()
                    if word == b"QUIT":
                        break

    Thread(target=serve, daemon=True).start()
    yield listening.getsockname()[1], taken
    listening.close()


def sent(database):
    """Return the only message, once it was sent."""
    with database.reading() as connection:
        return connection.execute(select(notices).where(notices.c.sent.is_not(None))).first()


@contextmanager
def web_hook(failures=0):
    """Give the address of a webhook that fails some times, and what it has taken."""
    taken, left = [], [failures]

    class Hook(BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            if left[0]:
                left[0] -= 1
                self.send_error(500)
                return
            taken.append(json.loads(body))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *args):
            pass

    server = HTTPServer(("127.0.0.1", 0), Hook)
    Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/hook", taken
    server.shutdown()
    server.server_close()


@pytest.fixture
def database(tmp_path):
    database = Database(tmp_path / "site.sqlite")
    yield database
    database.close()


def change(database, *subjects, notify=()):
    standing = [Raised("wall", s, DATA, tuple(notify)) for s in subjects]
    with database.writing() as connection:
        return reconcile(connection, None, None, ["wall"], standing, time.time()).events


@contextmanager
def sending(database, server=None):
    told = []
    notices = AlarmNotices(database, "Dam", server, told=told.append)
    notices.start()
    yield told
    notices.stop()


def test_an_alarm_and_its_end_are_mailed_once(database):
    with mail_server() as (port, taken):
        server = MailServer("127.0.0.1", port, "none", "site@example.org")
        with sending(database, server):
            change(database, "C", notify=["mailto:chief@example.org"])
            until(lambda: len(taken) == 1)
            change(database, "C", notify=["mailto:chief@example.org"])
            change(database)
            until(lambda: len(taken) == 2)
            time.sleep(1.5)
        assert len(taken) == 2
        assert "Subject: ALARM: wall, C (Dam)" in taken[0]
        assert "C has moved by 10.1 mm" in taken[0] and "To: chief@example.org" in taken[0]
        assert "Subject: cleared: wall, C (Dam)" in taken[1]


def test_a_message_that_fails_is_tried_again(database, monkeypatch):
    monkeypatch.setattr("factorgraph_adj.site.alarm_notices.FIRST_RETRY", 0.2)
    with web_hook(failures=2) as (address, taken), sending(database):
        change(database, "C", notify=[address])
        row = until(lambda: sent(database))
        assert taken[0]["site"] == "Dam" and taken[0]["alarm"]["points"] == ["C"]
        assert row.tries == 3 and row.sent is not None


def test_a_message_is_sent_after_a_restart(database):
    with web_hook() as (address, taken):
        change(database, "C", notify=[address])
        assert not taken
        with sending(database):
            until(lambda: taken)


def test_a_message_is_given_up_and_told(database, monkeypatch):
    monkeypatch.setattr("factorgraph_adj.site.alarm_notices.GIVEN_UP_AFTER", -1.0)
    with sending(database) as told:
        change(database, "C", notify=["mailto:chief@example.org"])
        until(lambda: told)
        assert "no [smtp]" in told[0]


def test_all_problems_of_a_mail_server_are_told():
    with pytest.raises(InputError) as error:
        read_mail_server({"port": -1, "password": "secret", "colour": 1}, "site.toml")
    said = str(error.value)
    for part in ("host", "port", "sender", "password_env", "colour"):
        assert part in said
    assert "secret" not in said


def test_what_its_own_epoch_clears_never_was(database):
    """A reading of the epoch that raised it was taken out: nobody has to acknowledge it."""
    log = AlarmLog(database, {})
    standing = [Raised("wall", "C", DATA)]

    def at(moment, found):
        with database.writing() as connection:
            (told,) = reconcile(connection, None, None, ["wall"], found, moment).events
        return told

    at(1000.0, standing)
    told = at(1000.0, [])
    assert told["withdrawn"] and told["text"].startswith("withdrawn: ")
    assert (told["since"], told["until"]) == (1000.0, 1000.0)
    assert not log.listed(state="ended")
    at(2000.0, standing)
    told = at(3000.0, [])
    assert "withdrawn" not in told
    assert [a["since"] for a in log.listed(state="ended")] == [2000.0]
    assert [a["since"] for a in log.listed(state="all")] == [2000.0, 1000.0]
