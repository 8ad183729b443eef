"""Instruments of a site: lines become observations of its networks, whatever the database does."""

from __future__ import annotations

import time

from tests.support.sites import ADDRESS, served

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


def until(happens, seconds=20.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := happens():
            return found
        time.sleep(0.05)
    raise AssertionError(f"did not happen in {seconds} s")


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
    with served(tmp_path, more=INSTRUMENT) as client:  # the file is read again from its begin
        until(lambda: client.get("/api/v1/instruments").json()[0]["postings"] == 2)
        assert client.get(ADDRESS).json()["counts"]["observations"] == before


def test_a_line_that_is_wrong_is_told_in_the_health(tmp_path):
    (tmp_path / "level.gsi").write_bytes(b"rubbish\r\n" + SIGHT[0].encode())
    with served(tmp_path, more=INSTRUMENT) as client:
        health = until(
            lambda: [h for h in client.get("/api/v1/instruments").json() if h["postings"]]
        )[0]
        assert health["refused"] == 1 and "rubbish" in health["problem"]
        kinds = [e.kind for e in client.app.state.site.events.after(0)]
        assert "arrival" in kinds
