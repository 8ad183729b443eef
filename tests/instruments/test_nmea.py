"""NMEA 0183: checksums, positions, covariances, dates, pairs; examples of receivers' manuals."""

import math
from datetime import UTC, datetime

import numpy as np
import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments.nmea import NmeaPositions, covariance_of_gst
from factorgraph_adj.instruments.nmea_sentences import checksum, sentence_of

ARRIVAL = datetime(2026, 6, 1, 17, 28, 20, tzinfo=UTC).timestamp()
DAY = 86400.0


def signed(body):
    return f"${body}*{checksum(body):02X}"


GGA = signed(
    "GNGGA,172814.00,4723.46587704,N,01202.26957864,E,4,14,0.8,518.893,M,46.669,M,1.2,0031"
)
GST = signed("GNGST,172814.00,0.006,0.020,0.010,45.0,0.0158,0.0158,0.031")

PUBLISHED = (
    # Trimble, NMEA-0183 messages: GST, LLQ; Leica iCON gps 80, A.13 LLQ.
    "$GPGST,172814.0,0.006,0.023,0.020,273.6,0.023,0.020,0.031*6A",
    "$GPLLQ,034137.00,210712,,M,,M,3,15,0.011,,M*15",
    "$GPLLQ,154324.00,111414,546629.232,M,5250781.577,M,1,09,3.876,366.549,M*05",
    "$GNLLQ,154119.00,111414,546629.181,M,5250782.747,M,1,20,3.890,367.393,M*1D",
    "$GPLLQ,154119.00,111414,,,,,,09,,,*44",
)


@pytest.mark.published
@pytest.mark.parametrize("line", PUBLISHED)
def test_checksums_of_manuals_are_right(line):
    assert sentence_of(line + "\r\n").type in ("GST", "LLQ")


@pytest.mark.published
@pytest.mark.parametrize(
    ("major", "minor", "azimuth", "north", "east"),
    [
        (0.1054, 0.0953, 74.8583, 0.0960, 0.1048),  # NavCom Sapphire
        (2.0198, 1.2409, 169.6050, 1.9992, 1.2737),  # Fixposition
    ],
)
def test_the_ellipse_of_receivers_is_that_of_their_variances(major, minor, azimuth, north, east):
    """The convention of the azimuth, from true north, is that of two makers."""
    s, c = math.sin(math.radians(azimuth)), math.cos(math.radians(azimuth))
    assert math.hypot(major * s, minor * c) == pytest.approx(east, abs=1.1e-4)
    assert math.hypot(major * c, minor * s) == pytest.approx(north, abs=1.1e-4)
    found = covariance_of_gst(major, minor, math.radians(azimuth), (east, north, 1.0))
    axes = np.sqrt(np.linalg.eigvalsh(found[:2, :2]))
    np.testing.assert_allclose(axes, [minor, major], atol=2e-4)
    direction = np.linalg.eigh(found[:2, :2])[1][:, 1]
    assert math.degrees(math.atan2(*direction)) % 180.0 == pytest.approx(azimuth % 180.0, abs=0.5)


def test_an_ellipse_against_the_variances_gives_no_correlation():
    """Trimble's own example has the long axis to the west and the larger σ to the north."""
    found = covariance_of_gst(0.023, 0.020, math.radians(273.6), (0.020, 0.023, 0.031))
    np.testing.assert_allclose(found, np.diag([0.020**2, 0.023**2, 0.031**2]))


def test_gga_and_gst_make_a_position_with_its_covariance():
    positions = NmeaPositions()
    assert positions.take(GGA, ARRIVAL) == []
    (fix,) = positions.take(GST, ARRIVAL)
    assert fix.time == datetime(2026, 6, 1, 17, 28, 14, tzinfo=UTC).timestamp()
    latitude, longitude, height = fix.position
    assert math.degrees(latitude) == pytest.approx(47 + 23.46587704 / 60, abs=1e-12)
    assert math.degrees(longitude) == pytest.approx(12 + 2.26957864 / 60, abs=1e-12)
    assert height == pytest.approx(518.893 + 46.669)
    assert (fix.quality, fix.satellites, fix.age, fix.grid) == ("fixed", 14, 1.2, False)
    expected = [[250.0, 150.0, 0.0], [150.0, 250.0, 0.0], [0.0, 0.0, 961.0]]
    np.testing.assert_allclose(1e6 * fix.covariance, expected, atol=0.5)


def test_gst_may_come_first_and_south_and_west_are_negative():
    positions = NmeaPositions()
    assert positions.take(GST, ARRIVAL) == []
    line = signed("GPGGA,172814.00,3300.0,S,07030.0,W,5,9,1.0,500.0,M,30.0,M,,")
    (fix,) = positions.take(line, ARRIVAL)
    assert np.degrees(fix.position[:2]).tolist() == pytest.approx([-33.0, -70.5])
    assert (fix.quality, fix.age) == ("float", None)


def test_a_position_without_its_gst_comes_without_a_covariance():
    positions = NmeaPositions()
    positions.take(GGA, ARRIVAL)
    body = GGA[1:-3].replace("172814.00", "172815.00")
    (fix,) = positions.take(signed(body), ARRIVAL)
    assert fix.covariance is None and fix.time % 60 == 14.0
    (rest,) = positions.rest()
    assert rest.time % 60 == 15.0
    assert positions.rest() == []


def test_gns_has_the_lowest_quality_of_its_systems():
    positions = NmeaPositions(covariances="stated")
    for mode, quality in (("RRNN", "fixed"), ("RF", "float"), ("AN", "single")):
        body = f"GNGNS,172814.00,4723.0,N,01202.0,E,{mode},14,0.8,518.893,46.669,1.2,0031,V"
        (fix,) = positions.take(signed(body), ARRIVAL)
        assert fix.quality == quality
        assert fix.position[2] == pytest.approx(565.562)


def test_a_position_that_is_stated_again_is_taken_once():
    positions = NmeaPositions()
    positions.take(GGA, ARRIVAL)
    assert len(positions.take(GST, ARRIVAL)) == 1
    gns = signed("GNGNS,172814.00,4723.0,N,01202.0,E,RR,14,0.8,518.893,46.669,1.2,0031,V")
    assert positions.take(gns, ARRIVAL) == []
    assert positions.take(GST, ARRIVAL) == []
    assert positions.rest() == []
    assert positions.passed_over == {"position again": 1, "GST again": 1}


@pytest.mark.parametrize("shift", [-11.9 * 3600, 0.0, 11.9 * 3600])
def test_the_day_is_the_nearest_to_the_arrival(shift):
    positions = NmeaPositions(covariances="stated")
    true = datetime(2026, 6, 1, 17, 28, 14, tzinfo=UTC).timestamp()
    (fix,) = positions.take(GGA, true + shift)
    assert fix.time == true


def test_zda_has_the_date_for_files_and_across_midnight():
    positions = NmeaPositions(covariances="stated")
    with pytest.raises(InputError, match="time of day without a date"):
        positions.take(GGA)
    positions.take(signed("GPZDA,235959.00,31,12,2025,00,00"))
    (fix,) = positions.take(signed(GGA[1:-3].replace("172814.00", "000000.50")))
    assert fix.time == datetime(2026, 1, 1, tzinfo=UTC).timestamp() + 0.5


def test_llq_has_its_date_and_the_quality_as_a_position_error():
    positions = NmeaPositions()
    (fix,) = positions.take(PUBLISHED[3])
    assert datetime.fromtimestamp(fix.time, UTC).isoformat() == "2014-11-14T15:41:19+00:00"
    assert fix.position == (546629.181, 5250782.747, 367.393)
    assert (fix.grid, fix.quality, fix.satellites) == (True, "single", 20)
    assert np.trace(fix.covariance) == pytest.approx(3.890**2)
    assert fix.covariance[2, 2] == pytest.approx(4 * fix.covariance[0, 0])
    assert positions.take(PUBLISHED[4]) == []
    assert positions.passed_over["LLQ without a position"] == 1
    day_first = NmeaPositions(llq_date="ddmmyy")
    line = signed("GPLLQ,034137.00,210712,500000.1,M,5250000.2,M,3,15,0.011,400.3,M")
    (fix,) = day_first.take(line)
    assert datetime.fromtimestamp(fix.time, UTC).date().isoformat() == "2012-07-21"
    with pytest.raises(InputError, match="month 21"):
        positions.take(line)


def test_a_receiver_without_a_position_says_so():
    positions = NmeaPositions()
    (fix,) = positions.take(signed("GPGGA,172814.00,,,,,0,00,,,M,,M,,"), ARRIVAL)
    assert fix.position is None and fix.quality == "none"
    (fix,) = positions.take(signed("GPGGA,,,,,,0,00,,,M,,M,,"), ARRIVAL)
    assert fix.position is None and fix.time == ARRIVAL
    assert positions.take(signed("GPGST,172814.00,,,,,,,"), ARRIVAL) == []


def test_other_sentences_are_counted():
    positions = NmeaPositions()
    for body in ("GPGSV,1,1,00", "GPGSV,1,1,00", "PTNL,GGK,172814.00,071296,1"):
        assert positions.take(signed(body), ARRIVAL) == []
    assert positions.passed_over == {"GSV": 2, "TNL": 1}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (GGA[:-2] + "00", "characters were lost"),
        (GGA.replace("4723", "4724"), "characters were lost"),
        (GGA[:-3], "ends without a checksum"),
        ("hello", "no sentence of NMEA"),
        ("", "no sentence of NMEA"),
        (signed("GNGGA,176814.00,4723.4,N,01202.2,E,4,14,0.8,5,M,4,M,,"), "hhmmss"),
        (signed("GNGGA,172814.00,4763.4,N,01202.2,E,4,14,0.8,5,M,4,M,,"), "latitude must be"),
        (signed("GNGGA,172814.00,9100.0,N,01202.2,E,4,14,0.8,5,M,4,M,,"), "latitude must be"),
        (signed("GNGGA,172814.00,4723.4,X,01202.2,E,4,14,0.8,5,M,4,M,,"), "hemisphere"),
        (signed("GNGGA,172814.00,4723.4,N,01202.2,E,Q,14,0.8,5,M,4,M,,"), "quality"),
        (signed("GNGGA,172814.00,4723.4,N,01202.2,E,4,14,0.8,5,M,,,,"), "undulation"),
        (signed("GNGGA,172814.00,4723.4,N,01202.2,E,4,14,0.8,5,F,4,M,,"), "unit of the height"),
        (signed("GNGST,172814.00,1,1,1,1,0.000,0.01,0.02"), "σ of latitude"),
        (signed("GNGST,172814.00,1,1,1,1,0.01,nan,0.02"), "σ of longitude"),
        (signed("GNGNS,172814.00,4723.4,N,01202.2,E,RZ,14,0.8,5,4,,"), "mode must be"),
        (signed("GPZDA,235959.00,31,02,2025,00,00"), "is no date"),
        (signed("GPLLQ,034137.00,21071,1,M,2,M,3,15,0.01,4,M"), "six digits"),
    ],
)
def test_what_cannot_be_read_is_refused_with_the_reason(line, message):
    positions = NmeaPositions()
    with pytest.raises(InputError, match=message):
        positions.take(line, ARRIVAL)


def test_all_problems_of_a_sentence_come_together():
    with pytest.raises(InputError) as caught:
        NmeaPositions().take(signed("GNGGA,172814,4763.4,X,01202.2,Q,4,14,0.8,z,M,4,M,,"), ARRIVAL)
    assert len(caught.value.problems) == 4


@pytest.mark.parametrize("line", [GGA, GST, *PUBLISHED])
def test_every_changed_character_is_found(line):
    """The checksum catches each change of one character between $ and *."""
    for i in range(1, line.index("*")):
        for other in "0A,.":
            if other != line[i]:
                with pytest.raises(InputError):
                    sentence_of(line[:i] + other + line[i + 1 :])
