"""Lines that are damaged on their way: refused, never a fault, and never a change of the state."""

import json
import random

import pytest

import factorgraph_adj as fga
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.instruments import Instrument, ReceivedLine, read_instruments
from factorgraph_adj.instruments.grammars import grammar_words
from factorgraph_adj.instruments.nmea_sentences import checksum

BEGIN = 1_780_308_000.0


def signed(body):
    return f"${body}*{checksum(body):02X}"


def summed(text):
    return f"{text}{sum(text.encode()) & 0xFF:02X}"


def nmea(i):
    at = f"{12 + i // 3600:02d}{i // 60 % 60:02d}{i % 60:02d}.00"
    return [
        signed(f"GNLLQ,{at},060126,50.02,M,30.01,M,3,14,0.020,103.0,M"),
        signed(f"GNGGA,{at},4724.0,N,01200.0,E,4,14,0.8,453.0,M,47.0,M,1.2,0031"),
        signed(f"GNGST,{at},0.006,0.010,0.010,0.0,0.0100,0.0100,0.0200"),
    ]


def level(i):
    return [
        "410001+?......1",
        f"110002+{f'A{i}':0>8} 32...8+03000000 331.28+00150000",
        f"110003+{f'B{i}':0>8} 32...8+03000000 332.28+00120000",
        f"110004+{f'B{i}':0>8} 573..8-00000300 574..8+00006000",
    ]


TILT = {"kind": "vertical_angle", "station": "A", "target": "B", "value": "$X"}
LINES = {
    "nmea": (nmea, {"point": "G", "average": 0, "sigma_mm": 5}),
    "gsi-level": (level, {}),
    "gsi-online": (
        lambda i: [f"11000{i % 10}+0000000C 21...2+33440350 22...2+09836210 31...6+00583268"],
        {"station": "A", "post": "sights", "faces": 1},
    ),
    "sokkia-set": (
        lambda i: [
            summed(f"00{12345 + i} 0901530 3595959 "),
            summed(f"7,Ea,0100,,1.700,0,6.{570 + i},101.2345,200.0000,"),
        ],
        {"target": "P", "station": "A", "post": "sights", "faces": 1},
    ),
    "sensor-lines": (
        lambda i: [f"{BEGIN + i},{i}.5,20", json.dumps({"t": BEGIN + i, "X": i, "T": 20.5})],
        {
            "columns": ["t", "X", "T"],
            "time": "t",
            "time_format": "s",
            "sensors": {"temperature": "T degC"},
            "observations": [{**TILT, "unit": "mgon", "sigma_mgon": 1}],
        },
    ),
}


def instrument(word):
    table = {"name": "i", "network": "dam", "source": "tcp://h:1", "grammar": word}
    (settings,) = read_instruments([{**table, **LINES[word][1]}], where="site.toml")
    network = fga.Network("dam", frame=LocalFrame())
    return Instrument(settings, network=network)


def damaged(rng, text):
    """Return a line as a bad cable makes it."""
    data = bytearray(text.encode())
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(data)) if data else 0
        match rng.randrange(5):
            case 0:
                data[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                del data[at : at + rng.randrange(1, 9)]
            case 2:
                data[at:at] = data[at : at + rng.randrange(1, 9)]
            case 3:
                data[at:at] = rng.choice((b"9999999999999", b"-", b"nan", b"\xff\xfe", b"{", b"e9"))
            case _:
                del data[at:]
    return bytes(data)


@pytest.mark.parametrize("word", LINES)
def test_damaged_lines_are_no_fault(word):
    rng = random.Random(word)
    found = instrument(word)
    for number in range(1500):
        for text in LINES[word][0](number % 900):
            line = ReceivedLine(damaged(rng, text), BEGIN + number, number)
            for posting in found.take(line):
                json.dumps(posting.record, allow_nan=False)
    assert found.health.counts["refused"] > 500


@pytest.mark.parametrize("word", ["nmea", "sokkia-set", "gsi-level"])
def test_a_damaged_line_before_each_changes_no_observation(word):
    """Grammars with check sums or with a state from line to line: what is refused has no trace."""
    rng = random.Random(word)
    clean, noisy = instrument(word), instrument(word)
    seen = ([], [])
    for number in range(60):
        for text in LINES[word][0](number):
            received = BEGIN + 60.0 * number
            for found, postings in zip((clean, noisy), seen, strict=True):
                if found is noisy:
                    # A character that is lost at the end is found by all three.
                    found.take(ReceivedLine(text.encode()[: -rng.randrange(1, 4)], received, 1))
                made = found.take(ReceivedLine(text.encode(), received, 1))
                postings += [p.record["observations"] for p in made]
    assert seen[0] == seen[1] and len(seen[0]) >= 59
    refused = noisy.health.counts["refused"] - clean.health.counts["refused"]
    assert refused == 60 * len(LINES[word][0](0))


def test_each_grammar_of_lines_is_here():
    assert set(grammar_words()) - set(LINES) <= {"ros", "geocom"}
