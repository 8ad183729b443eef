"""A receiver of a site: NMEA sentences to postings in the frame of the network."""

import json
import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import TopocentricFrame
from factorgraph_adj.incremental.adjustment import IncrementalAdjustment
from factorgraph_adj.instruments import Instrument, ReceivedLine, read_instruments
from factorgraph_adj.instruments.nmea_sentences import checksum
from factorgraph_adj.service.stream import Stream

PHI, LAMBDA = 47.4, 12.0
FRAME = TopocentricFrame(math.radians(PHI), math.radians(LAMBDA), 500.0)
BEGIN = 1_780_308_000.0  # a full minute


def signed(body):
    return f"${body}*{checksum(body):02X}".encode()


def sentences(seconds, north_mm=0.0):
    """GGA and GST of an epoch, some millimetres north of the origin of the frame."""
    minutes = 60.0 * (PHI - 47.0) + north_mm / 1e3 / 30.8856 / 60.0 / 1.0003
    hour, minute, second = seconds // 3600 % 24, seconds // 60 % 60, seconds % 60
    time = f"{int(hour):02d}{int(minute):02d}{second:05.2f}"
    gga = f"GNGGA,{time},47{minutes:011.8f},N,01200.00000000,E,4,14,0.8,453.0,M,47.0,M,1.2,0031"
    gst = f"GNGST,{time},0.006,0.010,0.010,0.0,0.0100,0.0100,0.0200"
    return signed(gga), signed(gst)


def settings(**keys):
    table = {
        "name": "gnss1",
        "network": "dam",
        "source": "tcp://127.0.0.1:4001",
        "grammar": "nmea",
        "point": "antenna 1",
        "antenna_height": 0.5,
        "rename": {"antenna 1": "G1"},
        **keys,
    }
    (found,) = read_instruments([table], where="site.toml")
    return found


def network():
    out = fga.Network("dam", frame=FRAME)
    out.add_point("G1", (1.0, 1.0, 0.0))
    return out


def postings(instrument, n, begin=BEGIN):
    out, number = [], 0
    for i in range(n):
        for text in sentences(begin + i):
            number += 1
            out += instrument.take(ReceivedLine(text, begin + i + 0.2, number))
    return out


def test_minutes_of_a_receiver_become_positions_of_the_mark():
    instrument = Instrument(settings(), network=network())
    found = postings(instrument, 181)
    assert [p.time - BEGIN for p in found] == [29.5, 89.5, 149.5]
    assert {p.network for p in found} == {"dam"}
    assert len({p.request for p in found}) == 3
    (record,) = found[0].record["observations"]
    assert (record["kind"], record["point"], record["axes"]) == ("gnss_position", "G1", "enu")
    assert [float(record[a]) for a in "xyz"] == pytest.approx([0.0, 0.0, -0.5], abs=1e-4)
    factor = 1.0 / math.tanh(0.5 / 100.0) / 60.0
    assert float(record["covariance_ee_mm2"]) == pytest.approx(100.0 * factor, rel=1e-3)
    assert instrument.health.counts["refused"] == 0
    assert instrument.health.counts["clock_jumps"] == 0


def test_the_stream_takes_the_postings():
    described = network()
    stream = Stream(IncrementalAdjustment(described))
    for number, posting in enumerate(postings(Instrument(settings(), network=described), 121), 1):
        answer = stream.answer(json.dumps(posting.record), number)
        assert answer["ok"], answer
    assert np.allclose(stream.adjustment.solution().point("G1"), [0, 0, -0.5], atol=1e-4)


def test_the_same_lines_have_the_same_requests():
    first, second = (postings(Instrument(settings(), network=network()), 121) for _ in range(2))
    assert [p.request for p in first] == [p.request for p in second]


def test_a_receiver_without_gst_needs_a_stated_sigma():
    instrument = Instrument(settings(average="10 s", sigma_mm=[10, 10, 20]), network=network())
    found = []
    for i in range(31):
        gga, _ = sentences(BEGIN + i)
        found += instrument.take(ReceivedLine(gga, BEGIN + i, i))
    assert len(found) >= 2
    instrument = Instrument(settings(average="10 s"), network=network())
    for i in range(3):
        gga, _ = sentences(BEGIN + i)
        assert instrument.take(ReceivedLine(gga, BEGIN + i, i)) == []
    assert "send GST, or state sigma_mm" in instrument.health.problem


def test_without_a_network_the_line_is_refused_with_the_reason():
    instrument = Instrument(settings(average=0))
    assert postings(instrument, 1) == []
    assert "frame of the network" in instrument.health.problem


def test_topics_are_receivers_of_their_own():
    instrument = Instrument(
        settings(point="", average="10 s", rename={"site/1": "G1", "site/2": "G2"}),
        network=network(),
    )
    found = []
    for i in range(12):
        for text in sentences(BEGIN + i):
            for topic in ("site/1", "site/2"):
                line = ReceivedLine(text, BEGIN + i, 1, channel=topic)
                found += instrument.take(line)
    assert [p.record["observations"][0]["point"] for p in found] == ["G1", "G2"]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"average": "a minute"}, "average must be a duration"),
        ({"average": "-1 s"}, "average must not be negative"),
        ({"least_quality": "good"}, "least_quality must be one of"),
        ({"sigma_mm": [1, 2]}, "sigma_mm must be one number above zero, or three"),
        ({"sigma_mm": -1}, "sigma_mm must be"),
        ({"sigma_factor": 0}, "sigma_factor must be greater"),
        ({"covariances": "stated"}, "needs sigma_mm"),
        ({"covariances": "none"}, "covariances must be"),
        ({"llq_date": "yymmdd"}, "llq_date must be"),
        ({"antena_height": 1}, "did you mean 'antenna_height'"),
    ],
)
def test_options_are_checked_with_the_site_file(keys, message):
    with pytest.raises(InputError, match=message):
        settings(**keys)


def test_sentences_without_a_position_may_repeat():
    """A receiver sends the same satellites every second: that is no doubled line."""
    instrument = Instrument(settings(), network=network())
    satellites = signed("GNGSA,A,3,04,05,09,12,24,25,29,31,,,,,1.8,1.0,1.5")
    for i in range(10):
        assert instrument.take(ReceivedLine(satellites, BEGIN + i, i)) == []
    counts = instrument.health.counts
    assert (counts["without_reading"], counts["doubled"], counts["refused"]) == (10, 0, 0)
