"""Readings whose time is still to come: refused with a reason, and all others are as without."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from factorgraph_adj.instruments.distance_corrections import SensorBoard
from factorgraph_adj.instruments.instrument import Instrument
from factorgraph_adj.instruments.instrument_settings import read_instruments
from factorgraph_adj.instruments.message_rules import iso
from factorgraph_adj.instruments.readings import ReceivedLine
from factorgraph_adj.instruments.simulated_sites import tunnel, write_site
from factorgraph_adj.instruments.simulated_total_station import SimulatedObject
from factorgraph_adj.site.network_clock import NetworkClock
from factorgraph_adj.site.site import Site
from factorgraph_adj.site.site_file import MAX_AHEAD, NetworkSettings, read_site
from tests.networks.yard import ARRIVALS
from tests.support.sites import BEGIN, HOUR, site_of, until, yard_of, yard_site

BARE = [{k: v for k, v in a.items() if k != "id"} for a in ARRIVALS]
pytestmark = pytest.mark.usefixtures("store")


def posted(live, *records, who="ts2"):
    return [f.result(30) for f in [live.submit(r, who) for r in records]]


def refusals(site):
    return [e.data for e in site.events.after(0) if e.kind == "refused"]


def test_summer_time_of_one_instrument_ends_no_epoch_of_the_others(tmp_path):
    """Its readings are refused alone, told with their reason, and enter with the right time."""
    now = time.time()
    right = [{**a, "time": now, "request": f"a{n}"} for n, a in enumerate(BARE)]
    wrong = {**BARE[3], "time": now + HOUR, "request": "ts2 1"}
    with site_of(tmp_path, epochs="1 h") as site:
        live = yard_of(site)
        answers = posted(live, *right[:3], wrong, *right[3:])
        assert [a["ok"] for a in answers] == [True] * 3 + [False] + [True] * (len(right) - 3)
        (problem,) = answers[3]["error"]
        assert problem["where"] == "time"
        said = problem["what"]
        label = f"{wrong['kind']} {wrong['station']} → {wrong['target']}, from ts2: "
        assert said.startswith(f"{label}its time {iso(now + HOUR)} is 1 h")
        assert "ahead of the clock of this machine" in said and "(max_ahead, 10 min)" in said
        (event,) = refusals(site)
        assert event["by"] == "ts2" and event["time"] == wrong["time"]
        assert event["answer"]["error"] == [problem]
        assert [r["state"] for r in live.epochs()] == ["closed", "open"]
        assert abs(live.clock.now() - time.time()) < 60.0
    with site_of(tmp_path) as site:  # sent again, after a restart, and then with the right time
        live = yard_of(site)
        again = posted(live, wrong, *right, {**wrong, "time": now})
        assert not again[0]["ok"] and all(a["repeated"] for a in again[1:-1])
        assert again[-1]["ok"] and "repeated" not in again[-1]
        assert len(live.epochs()) == 2
        with live.reading() as epoch:
            assert len(epoch.stream.adjustment) == len(right) + 1


def test_a_set_that_was_measured_in_the_future_excludes_no_later_ones(tmp_path):
    now = time.time()
    measured = {"instrument": "ts7", "begin": now, "end": now + 2 * 86400.0}
    given = {"do": "add", "observations": BARE[:2], "time": now}
    with site_of(tmp_path, epochs="1 h") as site:
        (bad,) = posted(yard_of(site), {**given, "measured": measured})
        assert "and 1 more, from ts7: its time" in bad["error"][0]["what"]
        assert "is 2 d ahead" in bad["error"][0]["what"]
        (good,) = posted(yard_of(site), {**given, "measured": {**measured, "end": now + 1.0}})
        assert good["ok"]


@pytest.mark.parametrize("length", ["by hand", "2 sets"])
def test_epochs_without_a_length_do_not_begin_in_the_future(tmp_path, length):
    with site_of(tmp_path, epochs=length) as site:
        live = yard_of(site)
        live.close_epoch().result(30)
        bad, good = posted(live, {**BARE[0], "time": time.time() + 3 * HOUR}, BARE[0])
        assert not bad["ok"] and good["ok"]
        assert live.epochs()[-1]["begin"] <= time.time()


def test_a_network_that_is_played_has_the_time_of_its_readings(tmp_path):
    """Ahead of the machine, faster than it, and a reading is compared with the others."""
    file = yard_site(tmp_path, epochs="1 h") / "site.toml"
    more = 'clock = "readings"\nmax_ahead = "90 min"\nobjects'
    file.write_text(file.read_text().replace("objects", more, 1))
    begin = time.time() + 30 * 60.0
    with site_of(tmp_path) as site:
        live = yard_of(site)
        times = [begin + HOUR * n for n in (0, 1, 2, 9, 3)]
        answers = [posted(live, {**BARE[0], "time": t})[0] for t in times]
        assert [a["ok"] for a in answers] == [True, True, True, False, True]
        said = answers[3]["error"][0]["what"]
        assert "is 7 h ahead of the latest reading of the network" in said and "1 h 30 min" in said
        assert live.epochs()[-1]["number"] == 4
    with site_of(tmp_path) as site:
        (late,) = posted(yard_of(site), {**BARE[0], "time": begin + 9 * HOUR})
        assert not late["ok"] and "ahead of the latest reading" in late["error"][0]["what"]


def test_readings_without_a_time_are_of_now_on_the_clock_of_a_played_network(tmp_path):
    """They came with the time of this machine, into an epoch that had ended long ago."""
    file = yard_site(tmp_path, epochs="1 h") / "site.toml"
    file.write_text(file.read_text().replace("objects", 'clock = "readings"\nobjects', 1))
    begin = HOUR * (time.time() // HOUR - 48.0)
    live = yard_of(site := Site(read_site(tmp_path)))
    # They wait together: those without a time go by those before them.
    came = [live.submit({**BARE[0], "time": begin + HOUR * n}) for n in (0, 1, 90, 91)]
    bare = {**BARE[1], "request": "bare"}
    came += [live.submit(r) for r in (bare, BARE[2])]
    came += [live.submit({**BARE[3], "time": begin + HOUR * 92}), live.submit(BARE[3])]
    site.start()
    try:
        assert [f.result(30)["epoch"] for f in came] == [1, 2, 91, 92, 92, 92, 93, 93]
        (told,) = [e.data["what"] for e in site.events.after(0) if e.kind == "problem"]
        assert "has begun epoch 91, and epochs 3 to 90 have no readings" in told
        (again,) = posted(live, bare)
        assert again["repeated"] and again["epoch"] == 92
        assert not [e for e in site.events.after(0) if e.data.get("what") == "reopened"]
    finally:
        site.stop()


def test_a_posting_that_its_sender_kept_is_as_much_earlier(tmp_path):
    """The sender of a played site knows how long it kept a reading, not the time there."""
    file = yard_site(tmp_path, epochs="1 h") / "site.toml"
    file.write_text(file.read_text().replace("objects", 'clock = "readings"\nobjects', 1))
    begin, now = HOUR * (time.time() // HOUR - 48.0), time.time()
    with site_of(tmp_path) as site:
        live = yard_of(site)
        posted(live, *({**BARE[0], "time": begin + HOUR * (n + 0.5)} for n in range(4)))
        (kept,) = posted(live, {**BARE[1], "kept": now - 2.0 * HOUR})
        assert (kept["ok"], kept["epoch"]) == (True, 2)
        (bad,) = posted(live, {**BARE[1], "kept": "yesterday"})
        assert bad["error"] == [
            {"where": "kept", "what": "kept must be seconds since 1970 UTC, a number"}
        ]


def test_times_of_the_past_are_those_of_a_played_network(tmp_path):
    with site_of(tmp_path, epochs="1 h") as site:
        given = [{**BARE[0], "time": BEGIN + years * 366 * 86400.0} for years in (0, 1, 2)]
        assert all(a["ok"] for a in posted(yard_of(site), *given))


def test_a_simulation_at_speed_writes_that_its_site_is_played(tmp_path):
    for speed, clock in ((1.0, "machine"), (120.0, "readings")):
        site = tunnel()
        stations = site.total_stations(SimulatedObject(site.network), begin=BEGIN, seed=0)
        folder = tmp_path / str(speed)
        write_site(folder, site, stations, [4001], speed=speed)
        (network,) = read_site(folder).networks
        assert (network.clock, network.max_ahead) == (clock, MAX_AHEAD[clock])


def weather() -> tuple[Instrument, SensorBoard]:
    """Return a sensor that states its times, and the board for its values."""
    table = {"name": "wx", "network": "yard", "source": "file:wx", "grammar": "sensor-lines"}
    table |= {"columns": ["t", "T"], "time": "t", "time_format": "s", "clock": "stated"}
    table |= {"sensors": {"temperature": "T degC"}}
    board = SensorBoard()
    limit = NetworkClock(NetworkSettings("yard", Path())).refuse_ahead
    (settings,) = read_instruments([table], where="site.toml")
    return Instrument(settings, sensors=board, refuse_ahead=limit), board


def test_a_sensor_with_a_wrong_clock_does_not_hold_up_the_right_values():
    now = 1_790_000_000.0
    instrument, board = weather()
    for number, (ahead, celsius) in enumerate([(0.0, 10.0), (HOUR, 99.0), (60.0, 11.0)], 1):
        text = f"{now + ahead},{celsius}".encode()
        instrument.take(ReceivedLine(text, now + 60.0, number))
    assert board.value("wx", "temperature", now + 60.0, 600.0) == pytest.approx(273.15 + 11.0)
    health = instrument.health.snapshot()
    assert health["refused"] == 1
    assert "line 2" in health["problem"] and "is 59 min ahead of the clock" in health["problem"]


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
clock = "stated"
[instrument.accuracies]
sigma_direction_mgon = 1.0
sigma_zenith_mgon = 1.0
sigma_distance_mm = 2.0
"""


def sight(at: float) -> bytes:
    """Return a sight from A to C at a time."""
    year, month = (time.strftime(f, time.gmtime(at)) for f in ("%y%S0000", "%m%d%H%M"))
    words = [("11....", "C"), ("18....", year), ("19....", month), ("21...2", "33440350")]
    words += [("22...2", "09836210"), ("31...6", "00583268"), ("87...0", "00000000")]
    return "".join(f"{code}+{text.zfill(8)} " for code, text in words).encode() + b"\r\n"


def test_an_instrument_whose_clock_is_ahead_has_it_as_its_problem(tmp_path):
    """So it has on the page, and its right readings enter."""
    file, now = tmp_path / "level.gsi", time.time()
    file.write_bytes(sight(now) + sight(now + 2 * HOUR) + sight(now + 1.0))
    with site_of(tmp_path, epochs="1 h", more=INSTRUMENT) as site:
        (health,) = until(lambda: [h for h in site.instruments.health() if h["postings"] == 2])
        assert (health["state"], health["refused"]) == ("ok", 1)
        assert "ahead of the clock of this machine" in health["problem"]
        shown = until(
            lambda: [
                e.data["instrument"]
                for e in site.events.after(0)
                if e.kind == "instrument" and e.data["instrument"]["problem"]
            ]
        )
        assert shown[0]["name"] == "level" and shown[0]["problem"] == health["problem"]
        until(lambda: sum(e.kind == "arrival" for e in site.events.after(0)) == 2)
        assert [r["number"] for r in yard_of(site).epochs()] == [0, 1]


def test_the_time_of_the_last_arrival_is_shown(tmp_path):
    with site_of(tmp_path) as site:
        live = yard_of(site)
        assert live.last_arrival is None
        before = time.time()
        posted(live, {**BARE[0], "time": time.time() + 3 * HOUR})
        assert live.last_arrival is None
        posted(live, {**BARE[0], "time": BEGIN})
        until(lambda: live.last_arrival is not None)
        assert before <= live.last_arrival <= time.time()
