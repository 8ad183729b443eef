"""Instruments of a site: lines become observations of its networks, whatever the database does."""

from __future__ import annotations

from datetime import UTC, datetime
from time import time

from factorgraph_adj.instruments.nmea_sentences import checksum
from tests.support.sites import ADDRESS, served, until

INSTRUMENT = """
[[instrument]]
name = "level"
network = "yard"
source = "file:level.gsi"
grammar = "gsi-online"
station = "A"
instrument_height = 0.0
post = "sights"
faces = 1
[instrument.accuracies]
sigma_direction_mgon = 1.0
sigma_zenith_mgon = 1.0
sigma_distance_mm = 2.0
"""
SIGHT = (
    "11....+0000000C 21...2+33440350 22...2+09836210 31...6+00583268 87...0+00000000 \r\n",
    "11....+0000000B 21...2+00000000 22...2+09920460 31...6+00800063 87...0+00000000 \r\n",
)


def test_lines_of_a_growing_file_become_observations_once(tmp_path):
    file = tmp_path / "level.gsi"
    file.write_bytes(SIGHT[0].encode())
    with served(tmp_path, more=INSTRUMENT) as client:

        def counted():
            return client.get(ADDRESS).json()["counts"]["observations"]

        def point():
            return {p["name"]: p for p in client.get(f"{ADDRESS}/points").json()}["C"]

        until(lambda: client.get("/api/v1/instruments").json()[0]["postings"] == 1)
        with file.open("ab") as stream:
            stream.write(SIGHT[1].encode())
        until(lambda: point()["determined"])
        assert abs(point()["z"] - 101.4996) < 0.01
        before = counted()
        assert before >= 5
        health = client.get("/api/v1/instruments").json()[0]
        assert (health["network"], health["refused"], health["not_posted"]) == ("yard", 0, 0)
        assert health["lag_s"] >= 0.0
    with served(tmp_path, more=INSTRUMENT) as client:  # the file is read again from its begin
        until(lambda: client.get("/api/v1/instruments").json()[0]["postings"] == 2)
        assert client.get(ADDRESS).json()["counts"]["observations"] == before
        lag = client.get("/api/v1/instruments").json()[0]["lag_s"]
        assert lag is None, "what was recorded before came in time then"


def test_a_line_that_is_wrong_is_told_in_the_health(tmp_path):
    (tmp_path / "level.gsi").write_bytes(b"rubbish\r\n" + SIGHT[0].encode())
    with served(tmp_path, more=INSTRUMENT) as client:
        health = until(
            lambda: [h for h in client.get("/api/v1/instruments").json() if h["postings"]]
        )[0]
        assert health["refused"] == 1 and "rubbish" in health["problem"]
        events = client.app.state.site.events
        until(lambda: "arrival" in [e.kind for e in events.after(0)])


RECEIVER = """
[[instrument]]
name = "gnss"
network = "yard"
source = "file:gnss.txt"
grammar = "nmea"
point = "antenna"
antenna_height = 1.5
average = "10 s"
rename = { antenna = "C" }
"""


AVERAGED = 30.0
"""Longest time after the first position at which the mean of some is, seconds."""


def test_positions_of_a_receiver_are_in_the_frame_of_the_network(tmp_path):
    lines = []
    for second in range(21):
        body = f"GNLLQ,1200{second:02d}.00,060126,50.02,M,30.01,M,3,14,0.020,103.0,M"
        lines.append(f"${body}*{checksum(body):02X}\r\n")
    (tmp_path / "gnss.txt").write_text("".join(lines))
    begun = time()
    with served(tmp_path, more=RECEIVER) as client:
        health = until(
            lambda: [h for h in client.get("/api/v1/instruments").json() if h["postings"] == 2]
        )[0]
        assert health["refused"] == 0
        until(lambda: client.get("/api/v1/instruments").json()[0]["lag_s"])
        lag = client.get("/api/v1/instruments").json()[0]["lag_s"]
        measured = datetime(2026, 6, 1, 12, 0, tzinfo=UTC).timestamp()
        assert begun - measured - AVERAGED <= lag <= time() - measured

        def found():
            points = {p["name"]: p for p in client.get(f"{ADDRESS}/points").json()}
            return points["C"] if points["C"]["determined"] else None

        point = until(found)
        assert abs(point["z"] - 101.5) < 1e-6
        assert abs(point["x"] - 50.02) < 1e-6 and abs(point["y"] - 30.01) < 1e-6


def test_a_password_that_is_missing_is_told(tmp_path):
    table = RECEIVER.replace("file:gnss.txt", "mqtt://a@127.0.0.1/t?password_env=NO_SUCH_VARIABLE")
    with served(tmp_path, more=table) as client:
        health = until(
            lambda: [h for h in client.get("/api/v1/instruments").json() if h["problem"]]
        )[0]
        assert health["problem"] == "the environment variable NO_SUCH_VARIABLE is not set"


def test_an_instrument_that_is_silent_raises_an_alarm_until_it_sends(tmp_path):
    file = tmp_path / "level.gsi"
    file.write_bytes(SIGHT[0].encode())
    rule = '[[alarm]]\nname = "quiet"\ntest = "silence"\nafter = 1.5\n'
    with served(tmp_path, more=INSTRUMENT + rule) as client:
        (alarm,) = until(lambda: client.get("/api/v1/alarms").json())
        assert alarm["points"] == ["level"] and "nothing for more than 1.5 s" in alarm["text"]
        with file.open("ab") as stream:
            stream.write(SIGHT[1].encode())
        until(lambda: client.get("/api/v1/alarms").json() == [])
        (closed,) = client.get("/api/v1/alarms", params={"state": "all"}).json()[-1:]
        assert closed["state"] == "closed" and closed["until"] > closed["since"]


def test_an_epoch_ends_with_the_last_set_of_the_instrument(tmp_path):
    sets = INSTRUMENT.replace('post = "sights"', 'post = "sets"\ntargets = ["B", "C"]')
    file = tmp_path / "level.gsi"
    file.write_bytes("".join([*SIGHT, *SIGHT, *SIGHT]).encode())
    with served(tmp_path, epochs="2 sets", more=sets) as client:

        def states():
            return [(e["number"], e["state"]) for e in client.get(f"{ADDRESS}/epochs").json()]

        until(lambda: client.get("/api/v1/instruments").json()[0]["postings"] >= 2)
        until(lambda: (1, "closed") in states())
        with file.open("ab") as stream:
            stream.write("".join([*SIGHT, *SIGHT]).encode())
        until(lambda: (2, "closed") in states())


def test_sets_from_before_a_restart_count(tmp_path):
    sets = INSTRUMENT.replace('post = "sights"', 'post = "sets"\ntargets = ["B", "C"]')
    file = tmp_path / "level.gsi"
    file.write_bytes("".join(SIGHT).encode())
    options = {"epochs": "2 sets", "more": sets}
    with served(tmp_path, **options) as client:
        until(lambda: client.get("/api/v1/instruments").json()[0]["postings"] == 1)
        until(lambda: client.get(ADDRESS).json()["counts"]["observations"])
        assert [e["state"] for e in client.get(f"{ADDRESS}/epochs").json()] == ["open"]
    with served(tmp_path, **options) as client:
        with file.open("ab") as stream:
            stream.write("".join(SIGHT).encode())
        until(lambda: client.get(f"{ADDRESS}/epochs").json()[0]["state"] == "closed")
