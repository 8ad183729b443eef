"""GeoCOM: answers by their requests, return codes with their meaning, targets by their aims."""

from __future__ import annotations

from math import pi

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments import Instrument, ReceivedLine, read_instruments
from factorgraph_adj.instruments.geocom import PROCEDURES, GeoCom
from factorgraph_adj.io.observation_records import observation_from_record

GON = pi / 200
AIMS = {"A": [12.35, 98.77], "B": [399.9, 101.0]}


def read(of, text):
    return of.read(ReceivedLine(text.encode(), 10.0, 1))


def answer(*values, transaction=0, code=0, communication=0):
    return f"%R1P,{communication},{transaction}:{code}" + "".join(f",{v!r}" for v in values)


def test_an_answer_is_that_to_the_request_of_its_transaction():
    of = GeoCom(aims=AIMS)
    assert read(of, "%R1Q,2108,7:5000,1") == []
    assert read(of, "%R1Q,5008,8:") == []
    assert read(of, answer(2026, 11, transaction=8)) == []  # date and time: no reading
    hz, z = 12.3456 * GON, 98.7654 * GON
    (sight,) = read(of, answer(hz, z, 51.2345, transaction=7))
    assert (sight.target, sight.direction, sight.zenith) == ("A", hz, z)
    assert sight.distance == 51.2345
    with pytest.raises(InputError, match="no request before it"):
        read(of, answer(hz, z, 51.2345, transaction=7))


@pytest.mark.parametrize("number", PROCEDURES)
def test_values_stand_where_the_procedure_has_them(number):
    record = PROCEDURES[number]
    values = [0.1 + 0.01 * i for i in range(record.values)]
    values[record.direction], values[record.zenith] = 12.35 * GON, 98.77 * GON
    if record.distance is not None:
        values[record.distance] = 77.5
    (sight,) = read(GeoCom(aims=AIMS, answers=int(number)), answer(*values))
    assert (sight.direction, sight.zenith) == (values[record.direction], values[record.zenith])
    assert sight.distance == (None if record.distance is None else 77.5)
    with pytest.raises(InputError, match=f"has {record.values} values"):
        read(GeoCom(aims=AIMS, answers=int(number)), answer(*values, 1.0))


def test_codes_refuse_with_their_meaning():
    of = GeoCom(aims=AIMS, answers=2108)
    for code, what in (
        (1284, "accuracy is not guaranteed"),
        (1292, "nothing aimed at"),
        (99, "unk"),
    ):
        with pytest.raises(InputError, match=what):
            read(of, answer(0.1, 1.6, 5.0, code=code))
    with pytest.raises(InputError, match="communication failed: 3077"):
        read(of, answer(communication=3077))
    (sight,) = read(of, answer(12.35 * GON, 98.77 * GON, 0.0, code=1285))
    assert sight.distance is None and sight.direction is not None
    relaxed = GeoCom(aims=AIMS, answers=2108, accept_codes=[1284])
    assert read(relaxed, answer(12.35 * GON, 98.77 * GON, 5.0, code=1284))[0].distance == 5.0


def test_targets_follow_from_their_aims_in_both_faces():
    of = GeoCom(aims=AIMS, answers=2107)
    assert read(of, answer(0.05 * GON, 101.1 * GON))[0].target == "B"
    assert read(of, answer(199.95 * GON, 298.9 * GON))[0].target == "B"
    with pytest.raises(InputError, match=r"no target is aimed at by 50\.0000"):
        read(of, answer(50.0 * GON, 101.1 * GON))
    close = GeoCom(aims={**AIMS, "C": [12.5, 98.7]}, answers=2107)
    with pytest.raises(InputError, match="may aim at"):
        read(close, answer(12.4 * GON, 98.75 * GON))


@pytest.mark.parametrize(
    "text, why",
    [
        ("%R1P,0,0", "neither a request"),
        ("%R1P,0,0:0,1.0,x,2.0", "'x' is not a number"),
        ("%R1P,0,0:0,7.0,1.0,2.0", "from 0 to 2π"),
        ("%R1P,0,0:0,0.19,1.55,-2.0", "negative"),
        ("*110001+00000001", "neither a request"),
    ],
)
def test_what_is_no_answer_is_refused(text, why):
    with pytest.raises(InputError, match=why):
        read(GeoCom(aims=AIMS, answers=2108), text)


def test_wrong_options_are_told_together():
    with pytest.raises(InputError) as error:
        GeoCom(aims={"A": [1.0]}, answers=1, accept_codes=[1290], aim_tolerance_gon=0)
    assert len(error.value.problems) == 4


def test_two_faces_become_observations():
    table = {"name": "ts", "network": "n", "source": "file:x", "grammar": "geocom", "station": "P"}
    table |= {"aims": AIMS, "answers": 2108, "targets": ["A", "B"]}
    of = Instrument(read_instruments([table], where="site.toml")[0])
    sights = [(12.345, 98.765), (399.912, 101.012), (199.914, 298.990), (212.347, 301.237)]
    out = []
    for n, (hz, z) in enumerate(sights):
        text = answer(hz * GON, z * GON, 60.0 + n)
        out += of.take(ReceivedLine(text.encode(), 1.79e9 + n, n))
    (posting,) = out
    found = [observation_from_record(r) for r in posting.record["observations"]]
    directions = {o.target: o.value / GON for o in found if o.kind == "direction"}
    assert directions == pytest.approx({"A": 12.346, "B": 399.913})
    zeniths = {o.target: o.value / GON for o in found if o.kind == "zenith_angle"}
    assert zeniths == pytest.approx({"A": 98.764, "B": 101.011})
