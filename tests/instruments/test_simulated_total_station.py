"""Simulated total station: from its port through the mapping to an adjustment."""

from __future__ import annotations

import json
import tomllib
from threading import Event, Thread

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments import Instrument, ReceivedLine, read_instruments
from factorgraph_adj.instruments.simulated_sites import dam, instrument_table, tunnel
from factorgraph_adj.instruments.simulated_total_station import (
    SimulatedObject,
    SimulatedTotalStation,
)
from factorgraph_adj.io.observation_records import observation_from_record
from factorgraph_adj.service.stream import Stream

BEGIN = 1_790_000_000.0


def site_of(make, **options):
    site = make()
    of = SimulatedObject(site.network)
    return site, of, site.total_stations(of, begin=BEGIN, **options)


def settings_of(station, port=4001, network="dam", speed=60.0, **keys):
    document = tomllib.loads(instrument_table(station, port=port, network=network, speed=speed))
    document["instrument"][0].update(keys)
    del document["instrument"][0]["keep_lines"]
    (found,) = read_instruments(document["instrument"], where="site.toml")
    return found


def lines_of(station, sets):
    out = []
    for n, line in enumerate(station.lines(), 1):
        if line.time >= station.begin + sets * station.interval:
            return out
        out.append(ReceivedLine(line.text, line.time, n))
    return out


def postings_of(station, sets, **keys):
    of = Instrument(settings_of(station, **keys))
    return [p for line in lines_of(station, sets) for p in of.take(line)], of


def stream_of(site):
    return Stream(fga.IncrementalAdjustment(site.network, policy="reject", alpha=0.001))


def post_all(stream, postings):
    answers = [stream.answer(json.dumps(p.record), i) for i, p in enumerate(postings, 1)]
    assert all(a["ok"] for a in answers), [a for a in answers if not a["ok"]]
    return answers


@pytest.mark.parametrize("make, size", [(dam, 16), (tunnel, 8)])
def test_points_are_within_their_sigmas(make, size):
    site, of, stations = site_of(make, seed=3, gsi_size=size)
    stream = stream_of(site)
    for station in stations:
        postings, instrument = postings_of(station, 3)
        assert len(postings) == 3
        assert instrument.health.counts["refused"] == 0
        post_all(stream, postings)
    stream.adjustment.settle()
    solution = stream.adjustment.solution()
    truth = of.truth(BEGIN)
    free = [n for n, p in site.network.points.items() if not any(p.fixed)]
    errors = np.array([solution.point(n) - truth[n] for n in free])
    sigmas = np.sqrt([np.diag(solution.covariance(n)) for n in free])
    assert len(free) == len(truth) - 4
    assert np.abs(errors / sigmas).max() < 4.5
    chi2 = np.mean((errors / sigmas) ** 2)
    assert 0.4 < chi2 < 2.0  # correlated: not n degrees of freedom
    assert abs(solution.sigma0 - 1.0) < 4.0 / np.sqrt(2.0 * solution.redundancy)
    assert len(stream.adjustment.rejected) <= 3


def test_the_noise_is_that_which_the_mapping_states():
    """σ̂0 of twelve sets of three total stations: 1 within 3 of its standard deviations."""
    vtpv = redundancy = 0.0
    for seed in range(2):
        site, _, stations = site_of(dam, seed=seed)
        network = site.network
        for station in stations:
            for posting in postings_of(station, 6)[0]:
                network.add(*map(observation_from_record, posting.record["observations"]))
        solution = fga.adjust(network)
        vtpv += solution.vtpv
        redundancy += solution.redundancy
    assert redundancy > 1500
    assert abs(vtpv / redundancy - 1.0) < 3.0 * np.sqrt(2.0 / redundancy)


def test_a_displacement_is_found_and_a_gross_error_rejected():
    site, of, stations = site_of(dam, seed=5)
    for station in stations:
        station.switch_on("gross-error", target="D3", reading="zenith", size_mgon=20, at=0)
    stations[0].switch_on("displacement", point="D5", dy_mm=-12, at="15 min")
    before, after = stream_of(site), stream_of(site)
    doubted = []
    for station in stations:
        postings, instrument = postings_of(station, 4)
        doubted += [[e.what for e in instrument.health.events if "'D3'" in e.what]]
        post_all(before, postings[:2])
        post_all(after, postings[2:])
    assert all(sum("index" in what for what in of_station) == 1 for of_station in doubted)
    moved = {}
    for name, stream in (("before", before), ("after", after)):
        stream.adjustment.settle()
        moved[name] = stream.adjustment.solution().point("D5")
    assert np.allclose(of.truth(BEGIN + 3600)["D5"] - of.truth(BEGIN)["D5"], (0, -0.012, 0))
    assert np.abs(moved["after"] - moved["before"] - (0, -0.012, 0)).max() < 0.002


def test_the_same_seed_gives_the_same_lines():
    a, b = (site_of(tunnel, seed=7)[2][0] for _ in range(2))
    assert lines_of(a, 2) == lines_of(b, 2)
    assert lines_of(site_of(tunnel, seed=8)[2][0], 1) != lines_of(site_of(tunnel, seed=7)[2][0], 1)


def test_faults_change_what_is_sent():
    _, _, (station,) = site_of(tunnel)
    whole = lines_of(site_of(tunnel)[2][0], 1)
    station.switch_on("doubled", lines=3)
    station.switch_on("garbage", lines=1, at="100 s")
    station.switch_on("gap", length="40 s", at="200 s")
    found = lines_of(station, 1)
    assert len(found) == len(whole) + 3 - 5
    assert found[0].text == found[1].text
    of = Instrument(settings_of(station))
    for line in found:
        of.take(line)
    assert of.health.counts["doubled"] == 3
    assert of.health.counts["refused"] == 1


def test_wrong_target_and_refraction_change_readings_by_their_size():
    from factorgraph_adj.instruments.gsi_online import GsiOnline

    _, _, (plain,) = site_of(tunnel)
    _, _, (station,) = site_of(tunnel)
    station.switch_on("wrong-target", target="R1", read="R2", sights=1)
    a, b = (next(GsiOnline().read(lines_of(s, 1)[i])[0] for i in (0,)) for s in (plain, station))
    truth = station.of.readings("S1", ("R1", "R2"), BEGIN)
    assert a.target == b.target == "R1"
    assert abs(a.distance - truth["R1"][2]) < 0.005 and abs(b.distance - truth["R2"][2]) < 0.005
    with_more = station.of.readings("S1", ("R1",), BEGIN, 1.0)["R1"]
    bend = with_more[1] - truth["R1"][1]
    assert bend == pytest.approx(-truth["R1"][2] / (2 * 6_371_000), rel=0.02)


@pytest.mark.parametrize(
    "word, fields, why",
    [
        ("gross", {}, "did you mean"),
        ("gross-error", {"target": "X", "reading": "zenith"}, "must be one of"),
        ("gross-error", {"target": "D1", "reading": "distance", "size_mgon": 3}, "needs size_mm"),
        ("gap", {}, "length is missing"),
        ("gap", {"length": "ten"}, "duration"),
        ("creep", {"point": "D1"}, "dx_mm"),
        ("doubled", {"line": 2}, "unknown field"),
    ],
)
def test_wrong_faults_are_refused(word, fields, why):
    _, _, stations = site_of(dam)
    with pytest.raises(InputError, match=why):
        stations[0].switch_on(word, **fields)


def test_wrong_simulations_are_refused_with_all_problems():
    _, of, _ = site_of(dam)
    with pytest.raises(InputError) as error:
        SimulatedTotalStation(of, "Q", ("D1", "D2"), gsi_size=12, interval=5.0)
    assert len(error.value.problems) == 3


def run_over_tcp(station, sets, during=None, **keys):
    """Return postings and health of an instrument that is connected to a simulated one."""
    with station.serve(speed=20_000.0, sets=sets) as server:
        settings = settings_of(station, port=server.port, **keys)
        instrument, stop, postings = Instrument(settings), Event(), []
        instrument.source.first_delay = 0.05
        thread = Thread(target=instrument.run, args=(postings.append, stop))
        thread.start()
        if during is not None:
            during(server)
        assert server.finished.wait(30)
        wanted = len(server.sent)
        for _ in range(300):
            if instrument.health.counts["lines"] >= wanted:
                break
            stop.wait(0.02)
        stop.set()
        thread.join(10)
        assert not thread.is_alive()
    return postings, instrument.health


def test_lines_come_over_tcp_as_without_it():
    _, _, (station,) = site_of(tunnel, seed=2)
    expected, _ = postings_of(site_of(tunnel, seed=2)[2][0], 3)
    found, health = run_over_tcp(station, 3)
    assert [p.record for p in found] == [p.record for p in expected]
    assert [p.request for p in found] == [p.request for p in expected]
    assert health.state == "stopped" and health.counts["connections"] == 1


def test_a_connection_that_is_dropped_is_made_again():
    _, _, (station,) = site_of(tunnel, seed=2)
    station.switch_on("outage", length="10 min", at="9 min")

    found, health = run_over_tcp(station, 4)
    expected, _ = postings_of(site_of(tunnel, seed=2)[2][0], 4)
    assert health.counts["connections"] == 2
    assert [p.request for p in found] == [p.request for p in expected]
