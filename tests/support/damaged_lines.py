"""Lines of instruments of each grammar, and what a bad cable makes of them."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from math import pi
from typing import Any

from factorgraph_adj.instruments.nmea_sentences import checksum

BEGIN = 1_780_308_000.0
"""Time of the first line, seconds UTC."""


def signed(body: str) -> str:
    """Return a sentence of NMEA with its check sum."""
    return f"${body}*{checksum(body):02X}"


def summed(text: str) -> str:
    """Return a line of Sokkia with its check sum."""
    return f"{text}{sum(text.encode()) & 0xFF:02X}"


def nmea(i: int) -> list[str]:
    """Return the sentences of a position."""
    at = f"{12 + i // 3600:02d}{i // 60 % 60:02d}{i % 60:02d}.00"
    return [
        signed(f"GNLLQ,{at},060126,50.02,M,30.01,M,3,14,0.020,103.0,M"),
        signed(f"GNGGA,{at},4724.0,N,01200.0,E,4,14,0.8,453.0,M,47.0,M,1.2,0031"),
        signed(f"GNGST,{at},0.006,0.010,0.010,0.0,0.0100,0.0100,0.0200"),
    ]


def level(i: int) -> list[str]:
    """Return the lines of a levelled difference."""
    return [
        "410001+?......1",
        f"110002+{f'A{i}':0>8} 32...8+03000000 331.28+00150000",
        f"110003+{f'B{i}':0>8} 32...8+03000000 332.28+00120000",
        f"110004+{f'B{i}':0>8} 573..8-00000300 574..8+00006000",
    ]


TILT = {"kind": "vertical_angle", "station": "A", "target": "B", "value": "$X"}
LINES: dict[str, tuple[Callable[[int], list[str]], dict[str, Any]]] = {
    "geocom": (
        lambda i: [
            f"%R1Q,2108,{i % 8}:5000,1",
            f"%R1P,0,{i % 8}:0,{334.4035 * pi / 200!r},{98.3621 * pi / 200!r},58.{3200 + i % 99}",
        ],
        {"aims": {"C": [334.4, 98.36]}, "station": "A", "post": "sights", "faces": 1},
    ),
    "nmea": (nmea, {"point": "G", "average": 0, "sigma_mm": 5}),
    "gsi-level": (level, {}),
    "gsi-online": (
        lambda i: [
            f"11000{i % 10}+0000000C 21...2+33440350 22...2+09836210 31...6+{583000 + i:0>8}"
        ],
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
"""By the word of a grammar: lines by their number, and the keys of [[instrument]]."""


def damaged(rng: random.Random, text: str) -> bytes:
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
