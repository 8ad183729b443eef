"""MQTT: lines of instruments from topics, and messages to topics, by a broker such as mosquitto.

``source = "mqtt://HOST[:PORT]/TOPIC[,TOPIC…][?key=value&…]"`` subscribes to topics (``+`` and
``#`` as MQTT has them; a comma or question mark in a topic is written %2C or %3F); ``mqtts://`` is
TLS. Ports are 1883 and 8883 unless stated. Keys:

=================  ===============================================================================
``client``         client identifier; default: ``factorgraph-adj-`` and the checksum of the
                   address, so that the session is the same after a restart
``user``           user name; also ``mqtt://USER@HOST``
``password_env``   environment variable that holds the password
``password_file``  file whose first line is the password, relative to the folder of the site file
``ca``             file with the certificates that are trusted (TLS); default: those of the system
``cert`` ``key``   files with the certificate and key of the client (TLS)
``keep_alive``     seconds between signs of life (30)
=================  ===============================================================================

A password in the address is refused, since site files are shown and copied; passwords are read when
a connection is made, and stand in no message, log or repr.

**Delivery.** Subscriptions have QoS 1 and the session is persistent: what is published with QoS 1
while this source is away comes when it is back, as far as the broker keeps it. A message is
acknowledged after its lines were processed and what they came to was posted, that is, when the
source is asked for more: a message that was taken, but not posted before the process ended, comes
again, and is recorded once if its lines have times. What waits in memory for a set or an average
that is not complete is lost; ``post = "sights"`` and ``average = 0`` keep nothing. A message that
comes again because the connection broke before its acknowledgement is recognised by its identifier
and passed over. Retained messages, which a broker sends at every subscription, are passed over as
well: they are old. A broken connection is made again after 1 s, then twice as long each time up to
a minute.

**Payload.** UTF-8 text; a JSON object or array is one line, and of other text each line is one. The
topic is the channel of the line. More than `MAX_PAYLOAD_BYTES` is refused.

`publish` sends one message, such as an alarm, with QoS 1, and returns when the broker has it.

Source: OASIS, MQTT version 3.1.1 (2014), sections 3.1.2.4 (sessions), 4.3.2 (QoS 1) and 4.7
(topics). Tested against mosquitto 2.0.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event
from typing import TYPE_CHECKING, Any, ClassVar
from urllib.parse import unquote, urlsplit

from ..errors import InputError, known, system_reason
from .health import Health
from .readings import ReceivedLine

if TYPE_CHECKING:
    from paho.mqtt.client import Client

PORTS = {"mqtt": 1883, "mqtts": 8883}
"""Ports without and with TLS."""
MAX_PAYLOAD_BYTES = 1 << 20
"""Largest size of a message: 1 MB."""
MAX_WAITING = 10_000
"""Number of messages that wait to be processed: a broker sends those of QoS 1 only as others are
acknowledged; of QoS 0 further ones are lost, which is told."""
POLL_S = 0.2
"""Seconds after which a source that has nothing yields None."""
FIRST_DELAY_S, LONGEST_DELAY_S = 1, 60
"""Seconds before a connection is tried again: the first time, and the longest."""
QOS = 1
"""Quality of service: at least once."""
PUBLISH_TIMEOUT_S = 10.0
"""Seconds in which a broker has to take a message."""
KEPT_IDENTIFIERS = 1000
"""Number of messages whose identifiers are kept, so that they are known if they come again."""
ADDRESS_KEYS = (
    *("client", "user", "password_env", "password_file"),
    *("ca", "cert", "key", "keep_alive"),
)
"""Keys of an address."""


@dataclass(frozen=True)
class MqttAddress:
    """Broker, topics and how to log in; the password is not kept."""

    host: str
    port: int
    topics: tuple[str, ...]
    """Topics, or filters of topics."""
    tls: bool = False
    client: str = ""
    """Client identifier."""
    user: str = ""
    password_env: str = ""
    """Environment variable with the password."""
    password_file: Path | None = None
    """File with the password."""
    ca: Path | None = None
    """Trusted certificates; None: those of the system."""
    cert: Path | None = None
    """Certificate of the client."""
    key: Path | None = None
    """Its key."""
    keep_alive: int = 30
    """Seconds between signs of life."""

    def __str__(self) -> str:
        return f"{'mqtts' if self.tls else 'mqtt'}://{self.host}:{self.port}"

    def password(self) -> str | None:
        """Return the password; None: none is stated.

        Raises:
            InputError: the variable or file is missing.
        """
        if self.password_env:
            if self.password_env not in os.environ:
                raise InputError(f"the environment variable {self.password_env} is not set")
            return os.environ[self.password_env]
        if self.password_file is not None:
            try:
                lines = self.password_file.read_text(encoding="utf-8").splitlines()
            except OSError as error:
                raise InputError(f"{self.password_file.name}: {system_reason(error)}") from None
            if not lines:
                raise InputError(f"{self.password_file.name}: it is empty")
            return lines[0]
        return None


def mqtt_address(text: str, folder: Path = Path()) -> MqttAddress:
    """Return the address of a text, see the module.

    Args:
        text: ``mqtt://…`` or ``mqtts://…``.
        folder: folder to which files are relative.

    Raises:
        InputError: what is wrong with it.
    """
    scheme, _, rest = text.partition("://")
    rest, _, query = rest.partition("?")
    server, _, topics = rest.partition("/")
    # urlsplit would take # of a topic for a fragment.
    parts = urlsplit(f"//{server}")
    problems = []
    if scheme not in PORTS:
        problems.append(f"unknown scheme {scheme!r}; valid: {known(PORTS)}")
    try:
        host, port = parts.hostname or "", parts.port
    except ValueError:
        host, port = "", None
    if not host:
        problems.append("the host is missing: mqtt://HOST/TOPIC")
    if parts.password is not None:
        problems.append("a password does not stand in an address: use password_env or _file")
    named = tuple(unquote(t) for t in topics.split(",")) if topics else ()
    if not named:
        problems.append("the topic is missing: mqtt://HOST/TOPIC")
    problems += [p for t in named if (p := _why_no_filter(t))]
    given: dict[str, str] = {}
    for item in filter(None, query.split("&")):
        key, _, value = item.partition("=")
        if key not in ADDRESS_KEYS:
            problems.append(f"unknown key {key!r}; valid: {known(ADDRESS_KEYS, meant=key)}")
        elif key in given:
            problems.append(f"{key} stands twice")
        given[key] = unquote(value)
    if parts.username is not None and given.setdefault("user", unquote(parts.username)) != unquote(
        parts.username
    ):
        problems.append("two user names")
    if "password_env" in given and "password_file" in given:
        problems.append("give one of password_env and password_file")
    if ("password_env" in given or "password_file" in given) and "user" not in given:
        problems.append("a password needs a user")
    if scheme != "mqtts" and (tls := [k for k in ("ca", "cert", "key") if k in given]):
        problems.append(f"{tls[0]} belongs to mqtts://")
    if ("cert" in given) != ("key" in given):
        problems.append("cert and key are given together")
    seconds = given.pop("keep_alive", "30")
    if not (seconds.isascii() and seconds.isdigit() and 0 < int(seconds[:9]) <= 65535):
        problems.append(f"keep_alive must be 1 to 65535 seconds, not {seconds[:20]!r}")
        seconds = "30"
    if problems:
        raise InputError("; ".join(problems))
    files: dict[str, Any] = {
        k: folder / v for k in ("password_file", "ca", "cert", "key") if (v := given.pop(k, None))
    }
    digest = hashlib.sha256(f"{scheme}://{server}/{topics}".encode()).hexdigest()[:10]
    client = given.pop("client", "") or f"factorgraph-adj-{digest}"
    return MqttAddress(
        host,
        PORTS[scheme] if port is None else port,
        named,
        tls=scheme == "mqtts",
        client=client,
        user=given.get("user", ""),
        password_env=given.get("password_env", ""),
        **files,
        keep_alive=int(seconds),
    )


def _why_no_filter(topic: str) -> str:
    """Return why a text is no filter of topics; '' if it is one (MQTT 3.1.1, section 4.7)."""
    levels = topic.split("/")
    if not topic or "\0" in topic or len(topic.encode()) > 65535:
        return "a topic is a text of 1 to 65535 bytes"
    for i, level in enumerate(levels):
        if ("+" in level and level != "+") or ("#" in level and level != "#"):
            return f"topic {topic!r}: + and # stand alone between slashes"
        if level == "#" and i < len(levels) - 1:
            return f"topic {topic!r}: # stands at its end"
    return ""


def _client(address: MqttAddress, *, client_id: str, clean: bool) -> Client:
    """Return a client that is not connected.

    Raises:
        InputError: the extra is not installed, or a password or certificate cannot be read.
    """
    try:
        from paho.mqtt.client import Client, MQTTv311
        from paho.mqtt.enums import CallbackAPIVersion
    except ImportError:
        raise InputError(
            'MQTT needs paho-mqtt: pip install "factorgraph_adj[instruments]"'
        ) from None
    client = Client(
        CallbackAPIVersion.VERSION2,
        client_id=client_id,
        clean_session=clean,
        protocol=MQTTv311,
        manual_ack=not clean,
    )
    if address.user:
        client.username_pw_set(address.user, address.password())
    if address.tls:
        files = {k: str(v) for k in ("ca", "cert", "key") if (v := getattr(address, k)) is not None}
        try:
            client.tls_set(files.get("ca"), files.get("cert"), files.get("key"))
        except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
            reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or error
            raise InputError(f"{', '.join(files.values())}: no certificate: {reason}") from None
    client.reconnect_delay_set(FIRST_DELAY_S, LONGEST_DELAY_S)
    return client


@dataclass(frozen=True)
class _Message:
    """A message as it came."""

    topic: str
    payload: bytes
    received: float
    identifier: int
    connection: int
    """Number of the connection by which it came: its identifier belongs to that one."""
    again: bool
    """Whether the broker says that it sends it again."""


def lines_of_payload(payload: bytes) -> list[bytes]:
    """Return the lines of a payload: a JSON object or array is one."""
    text = payload.strip()
    if text[:1] in (b"{", b"["):
        try:
            json.loads(text)
        except (ValueError, RecursionError):
            pass
        else:
            return [text]
    return [line for line in payload.replace(b"\r", b"\n").split(b"\n") if line.strip(b" \t\0")]


@dataclass
class MqttSource:
    """Topics of a broker, see the module."""

    keeps_lines: ClassVar[bool] = True
    address: MqttAddress
    _queue: Queue[_Message] = field(init=False, repr=False)
    """Messages that wait."""
    _connection: int = field(default=0, init=False)
    """Number of the connection, from 1."""

    def lines(self, stop: Event, health: Health) -> Iterator[ReceivedLine | None]:
        """Yield the lines of messages until ``stop`` is set.

        Raises:
            InputError: the extra is not installed, or a password or certificate cannot be read.
        """
        self._queue = Queue(MAX_WAITING)
        client = _client(self.address, client_id=self.address.client, clean=False)
        self._listen(client, health)
        health.set_state("connecting")
        client.connect_async(self.address.host, self.address.port, self.address.keep_alive)
        client.loop_start()
        number = 0
        processed: dict[int, bytes] = {}
        try:
            while not stop.is_set():
                try:
                    message = self._queue.get(timeout=POLL_S)
                except Empty:
                    yield None
                    continue
                digest = hashlib.sha256(message.topic.encode() + message.payload).digest()
                if message.again and processed.get(message.identifier) == digest:
                    health.count("doubled")
                else:
                    for text in lines_of_payload(message.payload):
                        number += 1
                        yield ReceivedLine(text, message.received, number, channel=message.topic)
                if message.identifier:
                    processed.pop(message.identifier, None)
                    processed[message.identifier] = digest
                    if len(processed) > KEPT_IDENTIFIERS:
                        processed.pop(next(iter(processed)))
                    if message.connection == self._connection:
                        client.ack(message.identifier, QOS)
        finally:
            client.disconnect()
            client.loop_stop()
            health.set_state("connecting")

    def _listen(self, client: Client, health: Health) -> None:
        """Set what happens on events; the thread of the client calls it."""
        refused = [False]

        def connected(client: Client, _: Any, flags: Any, reason: Any, properties: Any) -> None:
            refused[0] = reason.is_failure
            if reason.is_failure:
                health.set_state("connecting")
                health.trouble(f"{self.address} refuses the connection: {reason}", time.time())
                return
            self._connection += 1
            health.count("connections")
            health.set_state("receiving")
            client.subscribe([(topic, QOS) for topic in self.address.topics])

        def subscribed(client: Client, _: Any, mid: int, reasons: Any, properties: Any) -> None:
            for topic, reason in zip(self.address.topics, reasons, strict=False):
                if reason.is_failure:
                    what = f"{self.address} refuses the topic {topic!r}: {reason}"
                    health.trouble(what, time.time())

        def failed(client: Client, _: Any) -> None:
            health.set_state("connecting")
            health.trouble(f"no connection to {self.address}", time.time())

        def disconnected(client: Client, _: Any, flags: Any, reason: Any, properties: Any) -> None:
            health.set_state("connecting")
            if reason.is_failure and not refused[0]:
                what = f"the connection to {self.address} ended: {reason}"
                health.trouble(what, time.time())

        def arrived(client: Client, _: Any, message: Any) -> None:
            identifier = message.mid if message.qos else 0
            what = ""
            if message.retain:
                health.count("left_out")
            elif len(message.payload) > MAX_PAYLOAD_BYTES:
                what = f"a message of {message.topic!r} has more than {MAX_PAYLOAD_BYTES} bytes"
            else:
                found = _Message(
                    message.topic,
                    message.payload,
                    time.time(),
                    identifier,
                    self._connection,
                    bool(message.dup),
                )
                try:
                    self._queue.put_nowait(found)
                except Full:
                    what = f"{MAX_WAITING} messages wait: one of {message.topic!r} is lost"
                else:
                    return
            if what:
                health.tell("refused", what, time.time())
            if identifier:
                client.ack(identifier, QOS)

        client.on_connect, client.on_subscribe = connected, subscribed
        client.on_connect_fail, client.on_disconnect = failed, disconnected
        client.on_message = arrived


def mqtt_source(rest: str, folder: Path = Path()) -> MqttSource:
    """Return the source of ``source = "mqtt:…"`` by what stands after the colon."""
    return MqttSource(mqtt_address(f"mqtt:{rest}", folder))


def mqtts_source(rest: str, folder: Path = Path()) -> MqttSource:
    """Return the source of ``source = "mqtts:…"`` by what stands after the colon."""
    return MqttSource(mqtt_address(f"mqtts:{rest}", folder))


def publish(
    address: MqttAddress,
    payload: str | bytes,
    *,
    retain: bool = False,
    timeout: float = PUBLISH_TIMEOUT_S,
) -> None:
    """Send a message to every topic of an address, and wait until the broker has it.

    Args:
        address: address with topics, not filters.
        payload: the message.
        retain: whether the broker keeps it for those who subscribe later.
        timeout: seconds in which all of it has to be done.

    Raises:
        InputError: the extra is not installed; a topic has + or #; the broker cannot be reached,
            refuses the connection, or does not confirm the message in time.
    """
    if wild := [t for t in address.topics if "+" in t or "#" in t]:
        raise InputError(f"a message cannot be sent to {wild[0]!r}: + and # are for subscriptions")
    client = _client(address, client_id="", clean=True)
    until = time.monotonic() + timeout
    answered, reasons = Event(), []

    def connected(client: Client, _: Any, flags: Any, reason: Any, properties: Any) -> None:
        reasons.append(reason)
        answered.set()

    client.on_connect = connected
    client.connect_timeout = timeout
    try:
        client.connect(address.host, address.port, address.keep_alive)
    except (OSError, ValueError) as error:
        reason = system_reason(error) if isinstance(error, OSError) else error
        raise InputError(f"no connection to {address}: {reason}") from None
    client.loop_start()
    try:
        if not answered.wait(max(0.0, until - time.monotonic())):
            raise InputError(f"{address} does not answer")
        if reasons[0].is_failure:
            raise InputError(f"{address} refuses the connection: {reasons[0]}")
        sent = [client.publish(t, payload, QOS, retain) for t in address.topics]
        for message in sent:
            message.wait_for_publish(max(0.0, until - time.monotonic()))
            if not message.is_published():
                raise InputError(f"{address} does not confirm a message")
    finally:
        client.disconnect()
        client.loop_stop()
