"""MQTT against a real broker: sessions, reconnects, passwords, TLS; addresses and payloads."""

from __future__ import annotations

import subprocess
import time
from threading import Event, Thread

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments import Instrument, read_instruments
from factorgraph_adj.instruments.health import Health
from factorgraph_adj.instruments.mqtt import (
    MqttSource,
    lines_of_payload,
    mqtt_address,
    mqtt_source,
    publish,
)
from tests.support.mosquitto import PROGRAM, Mosquitto, needs_mosquitto

PATIENCE_S = 30.0
SECRET = "tulip-4711"


class Listener:
    """A source in a thread, which processes lines as a mapping would."""

    def __init__(self, source, *, wait=0.0):
        self.source, self.wait = source, wait
        self.health = Health("gnss")
        self.stop, self.lines, self.error = Event(), [], None
        self.thread = Thread(target=self._run)

    def _run(self):
        try:
            for line in self.source.lines(self.stop, self.health):
                if line is not None:
                    time.sleep(self.wait)
                    self.lines.append(line)
        except InputError as error:
            self.error = error

    def texts(self):
        return [line.text.decode() for line in self.lines]

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.stop.set()
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()


def until(condition, what):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.02)


def receiving(listener):
    until(lambda: listener.health.state == "receiving", "never connected")
    time.sleep(0.2)  # the subscription is on its way


@needs_mosquitto
def test_lines_of_topics_come_with_their_topic_and_time(tmp_path):
    with Mosquitto(tmp_path) as broker:
        at = f"mqtt://127.0.0.1:{broker.port}"
        with Listener(mqtt_source(f"//127.0.0.1:{broker.port}/site/+/nmea,site/log")) as listener:
            receiving(listener)
            before = time.time()
            publish(mqtt_address(f"{at}/site/A/nmea"), "one\r\ntwo\n")
            publish(mqtt_address(f"{at}/site/log"), '{"a":\n 1}')
            publish(mqtt_address(f"{at}/other"), "three")
            publish(mqtt_address(f"{at}/site/B/nmea"), "four")
            until(lambda: len(listener.lines) >= 4, "lines are missing")
        assert listener.texts() == ["one", "two", '{"a":\n 1}', "four"]
        channels = [line.channel for line in listener.lines]
        assert channels == ["site/A/nmea", "site/A/nmea", "site/log", "site/B/nmea"]
        assert [line.number for line in listener.lines] == [1, 2, 3, 4]
        assert all(before <= line.received <= time.time() for line in listener.lines)
    assert listener.health.counts["connections"] == 1


@needs_mosquitto
def test_what_is_published_while_the_source_is_away_comes_afterwards(tmp_path):
    with Mosquitto(tmp_path) as broker:
        address = mqtt_address(f"mqtt://127.0.0.1:{broker.port}/t")
        with Listener(MqttSource(address)) as listener:
            receiving(listener)
        for i in range(50):
            publish(address, str(i))
        with Listener(MqttSource(address)) as again:
            until(lambda: len(again.lines) >= 50, "lines are missing")
            time.sleep(0.3)
        assert again.texts() == [str(i) for i in range(50)]


@needs_mosquitto
def test_a_message_that_was_not_processed_comes_again(tmp_path):
    """The process ends while it processes the second of three messages."""
    with Mosquitto(tmp_path) as broker:
        address = mqtt_address(f"mqtt://127.0.0.1:{broker.port}/t")
        stop = Event()
        lines = MqttSource(address).lines(stop, Health("a"))
        assert next(lines) is None
        for i in range(3):
            publish(address, str(i))
        found = []
        while len(found) < 2:
            line = next(lines)
            found += [] if line is None else [line.text]
        lines.close()  # the first is acknowledged, the second is not
        assert found == [b"0", b"1"]
        with Listener(MqttSource(address)) as again:
            until(lambda: len(again.lines) >= 2, "lines are missing")
            time.sleep(0.3)
        assert again.texts() == ["1", "2"]


@needs_mosquitto
def test_what_cannot_be_posted_is_not_acknowledged(tmp_path, monkeypatch):
    """The database is away while readings come; then the process ends, and another one begins."""
    monkeypatch.setattr("factorgraph_adj.instruments.instrument.RETRY_S", 0.05)
    with Mosquitto(tmp_path) as broker:
        address = mqtt_address(f"mqtt://127.0.0.1:{broker.port}/t")
        table = {
            "name": "extensometer",
            "network": "dam",
            "source": f"mqtt://127.0.0.1:{broker.port}/t",
            "grammar": "sensor-lines",
            "observations": [
                {
                    "kind": "slope_distance",
                    "station": "A",
                    "target": "B",
                    "value": "$d",
                    "unit": "m",
                    "sigma_mm": 1,
                }
            ],
        }
        (settings,) = read_instruments([table], where="site.toml")
        posted, away = [], [True]

        def post(posting):
            if away[0]:
                raise ConnectionError("the database is away")
            posted.append(float(posting.record["observations"][0]["value"]))

        def run(condition):
            instrument, stop = Instrument(settings), Event()
            thread = Thread(target=instrument.run, args=(post, stop))
            thread.start()
            try:
                until(lambda: condition(instrument.health), "did not happen")
            finally:
                stop.set()
                thread.join(PATIENCE_S)
            assert not thread.is_alive()
            return instrument.health

        run(lambda health: health.state == "receiving")
        for i in range(30):
            publish(address, f'{{"d": {i}}}')
        health = run(lambda health: health.counts["not_posted"] >= 3)
        assert health.counts["lines"] == 1  # the others wait at the broker
        away[0] = False
        run(lambda health: len(posted) >= 30)
        assert posted == list(range(30))


@needs_mosquitto
def test_a_broker_that_restarts_loses_and_doubles_nothing(tmp_path):
    broker = Mosquitto(tmp_path).start()
    try:
        address = mqtt_address(f"mqtt://127.0.0.1:{broker.port}/t")
        with Listener(MqttSource(address), wait=0.02) as listener:
            receiving(listener)
            for i in range(40):
                publish(address, str(i))
            broker.stop()  # lines wait, and some have no acknowledgement yet
            until(lambda: listener.health.state == "connecting", "not told")
            broker.start()
            until(lambda: listener.health.state == "receiving", "no reconnection")
            for i in range(40, 60):
                publish(address, str(i))
            until(lambda: len(listener.lines) >= 60, "lines are missing")
            time.sleep(0.5)
        assert sorted(map(int, listener.texts())) == list(range(60))
        assert listener.health.counts["connections"] == 2
        assert "ended" in listener.health.problem
    finally:
        broker.stop()


@needs_mosquitto
def test_retained_messages_are_old(tmp_path):
    with Mosquitto(tmp_path) as broker:
        address = mqtt_address(f"mqtt://127.0.0.1:{broker.port}/t")
        publish(address, "old", retain=True)
        with Listener(MqttSource(address)) as listener:
            receiving(listener)
            publish(address, "new")
            until(lambda: listener.lines, "the line is missing")
        assert listener.texts() == ["new"]
        assert listener.health.counts["left_out"] == 1


@needs_mosquitto
def test_passwords_are_read_and_shown_nowhere(tmp_path, monkeypatch, capfd):
    program = PROGRAM.replace("mosquitto", "mosquitto_passwd") if PROGRAM else ""
    users = tmp_path / "users"
    users.touch()
    for candidate in ("mosquitto_passwd", program):
        try:
            subprocess.run([candidate, "-b", str(users), "ts1", SECRET], check=True)
            break
        except FileNotFoundError:
            continue
    else:
        pytest.skip("mosquitto_passwd is not installed")
    (tmp_path / "secret.txt").write_text(SECRET + "\n")
    options = ["allow_anonymous false", f"password_file {users}"]
    with Mosquitto(tmp_path, options) as broker:
        at = f"mqtt://ts1@127.0.0.1:{broker.port}/t?password_"
        by_file = mqtt_address(f"{at}file=secret.txt", tmp_path)
        monkeypatch.setenv("SITE_PASSWORD", SECRET)
        by_env = mqtt_address(f"{at}env=SITE_PASSWORD")
        assert SECRET not in repr(by_file) + repr(MqttSource(by_env)) + str(by_env)
        with Listener(MqttSource(by_file)) as listener:
            receiving(listener)
            publish(by_env, "hello")
            until(lambda: listener.lines, "the line is missing")
        assert SECRET not in str(listener.health.snapshot())
        monkeypatch.setenv("SITE_PASSWORD", "wrong")
        with pytest.raises(InputError, match="refuses the connection: Not authorized"):
            publish(by_env, "hello")
        with Listener(MqttSource(by_env)) as refused:
            until(lambda: refused.health.problem, "not told")
            time.sleep(0.2)  # the broker closes the connection
        assert "refuses the connection" in refused.health.problem
        assert refused.health.state == "connecting"
    monkeypatch.delenv("SITE_PASSWORD")
    with pytest.raises(InputError, match="SITE_PASSWORD is not set"):
        publish(by_env, "hello")
    assert SECRET not in "".join(capfd.readouterr())


# paho-mqtt leaves the socket of a failed handshake to the garbage collection.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@needs_mosquitto
def test_tls_trusts_the_stated_certificate_alone(tmp_path):
    def openssl(*arguments):
        try:
            subprocess.run(["openssl", *arguments], check=True, capture_output=True, cwd=tmp_path)
        except FileNotFoundError:
            pytest.skip("openssl is not installed")

    for name in ("site", "stranger"):
        openssl(
            *("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2"),
            *("-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"),
            *("-keyout", f"{name}.key", "-out", f"{name}.crt"),
        )
    options = [
        "allow_anonymous true",
        f"certfile {tmp_path / 'site.crt'}",
        f"keyfile {tmp_path / 'site.key'}",
    ]
    with Mosquitto(tmp_path, options) as broker:
        at = f"mqtts://127.0.0.1:{broker.port}/t?ca="
        address = mqtt_address(f"{at}site.crt", tmp_path)
        with Listener(MqttSource(address)) as listener:
            receiving(listener)
            publish(address, "hello")
            until(lambda: listener.lines, "the line is missing")
        with pytest.raises(InputError, match="no connection"):
            publish(mqtt_address(f"{at}stranger.crt", tmp_path), "hello")
        with pytest.raises(InputError, match="no connection"):
            publish(mqtt_address(f"mqtts://127.0.0.1:{broker.port}/t"), "hello")
    with pytest.raises(InputError, match=r"missing\.crt"):
        publish(mqtt_address(f"{at}missing.crt", tmp_path), "hello")


@needs_mosquitto
def test_a_broker_that_is_not_there_is_waited_for(tmp_path):
    broker = Mosquitto(tmp_path)
    address = mqtt_address(f"mqtt://127.0.0.1:{broker.port}/t")
    with pytest.raises(InputError, match="no connection"):
        publish(address, "hello")
    with Listener(MqttSource(address)) as listener:
        until(lambda: listener.health.problem, "not told")
        assert listener.health.state == "connecting"
        with broker:
            receiving(listener)
            publish(address, "hello")
            until(lambda: listener.lines, "the line is missing")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mqtt://host", "topic is missing"),
        ("mqtt:///t", "host is missing"),
        ("http://host/t", "unknown scheme"),
        ("mqtt://host:x/t", "host is missing"),
        (f"mqtt://a:{SECRET}@host/t", "password does not stand"),
        ("mqtt://host/a+/t", "stand alone"),
        ("mqtt://host/a/#/t", "at its end"),
        ("mqtt://host/t?kee_alive=3", "did you mean 'keep_alive'"),
        ("mqtt://host/t?keep_alive=0", "1 to 65535"),
        ("mqtt://host/t?user=a&password_env=A&password_file=b", "one of"),
        ("mqtt://host/t?password_env=A", "needs a user"),
        ("mqtt://host/t?ca=x", "belongs to mqtts"),
        ("mqtts://host/t?cert=x", "together"),
        ("mqtt://a@host/t?user=b", "two user names"),
        ("mqtt://host/t?user=a&user=b", "twice"),
    ],
)
def test_addresses_that_are_wrong_are_refused(text, message):
    with pytest.raises(InputError, match=message) as caught:
        mqtt_address(text)
    assert SECRET not in str(caught.value)


def test_addresses_name_topics_and_files(tmp_path):
    found = mqtt_address(
        "mqtts://u@broker/a/%2C/+,b/#?ca=x.pem&password_file=p&client=me", tmp_path
    )
    assert found.topics == ("a/,/+", "b/#")
    assert (found.port, found.user, found.client) == (8883, "u", "me")
    assert found.ca == tmp_path / "x.pem" and found.password_file == tmp_path / "p"
    one, same, other = (mqtt_address(f"mqtt://h/{t}").client for t in ("a", "a", "b"))
    assert one == same != other


def test_messages_are_not_sent_to_filters():
    with pytest.raises(InputError, match="for subscriptions"):
        publish(mqtt_address("mqtt://127.0.0.1/a/+"), "x")


def test_json_is_one_line_and_text_many():
    assert lines_of_payload(b' {"a":\n1}\n') == [b'{"a":\n1}']
    assert lines_of_payload(b"[1,\n2]") == [b"[1,\n2]"]
    assert lines_of_payload(b'{"a":1}\n{"a":2}\n') == [b'{"a":1}', b'{"a":2}']
    assert lines_of_payload(b"a\r\n\r\nb\rc") == [b"a", b"b", b"c"]
    assert lines_of_payload(b" \n\0") == []
