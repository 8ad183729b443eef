"""Field books of one small survey in every format: three known points, one free station."""

from __future__ import annotations

import math
from dataclasses import dataclass

from factorgraph_adj.errors import LeftOut
from factorgraph_adj.io.source import NOTES
from factorgraph_adj.network.network import Network
from factorgraph_adj.units import GON
from tests.hostile.examples import Example

KNOWN = {"A": (0.0, 0.0, 100.0), "B": (60.0, 10.0, 101.0), "C": (-20.0, 50.0, 103.0)}
STATION = (15.0, 20.0, 102.0)
HEIGHT, TARGET = 1.5, 1.6
ORIENTATION = 37.0 * GON
INDEX, COLLIMATION = 2.0e-3 * GON, 1.5e-3 * GON


@dataclass(frozen=True)
class Sight:
    """A sight in one face, radians and metres."""

    target: str
    face: int
    direction: float
    zenith: float
    distance: float


def sights() -> list[Sight]:
    """Return error-free readings in both faces of an instrument with errors of its circles."""
    out = []
    for face in (1, 2):
        for name, (x, y, z) in KNOWN.items():
            d = x - STATION[0], y - STATION[1], z + TARGET - STATION[2] - HEIGHT
            level, slope = math.hypot(*d[:2]), math.hypot(*d)
            hz, v = math.atan2(d[0], d[1]) - ORIENTATION, math.acos(d[2] / slope)
            c = COLLIMATION / math.sin(v)
            hz, v = (
                (hz - c, v + INDEX) if face == 1 else (hz + c + math.pi, 2 * math.pi - v + INDEX)
            )
            assert level > 0
            out.append(Sight(name, face, hz % (2 * math.pi), v, slope))
    return out


def gsi(size: int = 16) -> str:
    """Return the survey as GSI; gon with 5 decimals, 0.1 mm."""

    def word(index: str, info: str, value: float | str) -> str:
        if isinstance(value, str):
            return f"{index}{info}+{value.rjust(size, '0')} "
        return f"{index}{info}{'-' if value < 0 else '+'}{abs(round(value)):0{size}d} "

    star = "*" * (size == 16)
    lines = []
    for i, (name, xyz) in enumerate(KNOWN.items(), start=1):
        words = "".join(
            word(w, "...0", 1e3 * v) for w, v in zip(("81", "82", "83"), xyz, strict=True)
        )
        lines.append(f"{star}{word('11', f'{i:04d}', name)}{words}")
    lines.append(f"{star}{word('11', '0009', 'S')}{word('88', '...0', 1e3 * HEIGHT)}")
    for i, s in enumerate(sights(), start=10):
        lines.append(
            star
            + word("11", f"{i:04d}", s.target)
            + word("21", ".322", s.direction / GON * 1e5)
            + word("22", ".322", s.zenith / GON * 1e5)
            + word("31", "...6", 1e4 * s.distance)
            + word("51", "....", "0008-034"[: size // 2])
            + word("87", "...0", 1e3 * TARGET)
        )
    return "\n".join(lines) + "\n"


def sdr33() -> str:
    """Return the survey as SDR33, gon."""

    def f(*values: float | str) -> str:
        return "".join((v if isinstance(v, str) else f"{v:.8f}")[:16].ljust(16) for v in values)

    lines = ["00NMSDR33 V04-04.02     01-Jan-04 16:26 211111", "10NMJOB             121111"]
    lines.append("01NM:" + f("SET") + "000000" + f("SET") + "000000" + "31" + f(0.0, 0.0, 0.0))
    lines += ["08KI" + f(n, y, x, z, "control") for n, (x, y, z) in KNOWN.items()]
    lines.append("02KI" + f("S", "", "", "", HEIGHT, ""))
    lines.append("03NM" + f(TARGET))
    for s in sights():
        angles = s.zenith / GON, s.direction / GON
        lines.append(f"09F{s.face}" + f("S", s.target, s.distance, *angles, ""))
    return "\n".join(lines) + "\n"


def jobxml(constant: float = -0.035, ppm: float = 12.0) -> str:
    """Return the survey as JobXML: raw distances, without prism constant and ppm."""
    deg = 180.0 / math.pi
    records = [
        '<StationRecord ID="s1"><StationName>S</StationName>'
        "<TheodoliteHeight>1.5</TheodoliteHeight><AtmosphereID>a1</AtmosphereID></StationRecord>",
        f'<AtmosphereRecord ID="a1"><PPM>{ppm}</PPM>'
        "<ApplyPPMToRawDistances>true</ApplyPPMToRawDistances></AtmosphereRecord>",
        f'<TargetRecord ID="t1"><TargetHeight>{TARGET}</TargetHeight>'
        f"<PrismConstant>{constant}</PrismConstant></TargetRecord>",
    ]
    for name, (x, y, z) in KNOWN.items():
        records.append(
            f"<PointRecord ID='k{name}'><Name>{name}</Name><Deleted>false</Deleted><Grid>"
            f"<North>{y}</North><East>{x}</East><Elevation>{z}</Elevation></Grid></PointRecord>"
        )
    for i, s in enumerate(sights()):
        raw = (s.distance - constant) / (1.0 + 1e-6 * ppm)
        records.append(
            f"<PointRecord ID='p{i}'><Name>{s.target}</Name><Deleted>false</Deleted><Circle>"
            f"<HorizontalCircle>{s.direction * deg:.12f}</HorizontalCircle>"
            f"<VerticalCircle>{s.zenith * deg:.12f}</VerticalCircle>"
            f"<EDMDistance>{raw:.6f}</EDMDistance><Face>Face{s.face}</Face>"
            "<HorizontalCircleStandardError>0.0006</HorizontalCircleStandardError>"
            "</Circle><StationID>s1</StationID><TargetID>t1</TargetID></PointRecord>"
        )
    records.append(
        "<PointRecord ID='x'><Name>A</Name><Deleted>true</Deleted><Circle><HorizontalCircle>1"
        "</HorizontalCircle><VerticalCircle>90</VerticalCircle><EDMDistance>7</EDMDistance>"
        "<Face>Face1</Face></Circle><StationID>s1</StationID></PointRecord>"
    )
    body = "\n".join(records)
    return (
        f'<?xml version="1.0"?>\n<JOBFile version="5.6"><FieldBook>\n{body}\n</FieldBook></JOBFile>'
    )


def landxml(*, hexml: bool = False) -> str:
    """Return the survey as LandXML, or with the namespace and the extension of HeXML."""
    points = "\n".join(
        f'<CgPoint name="{n}">{y} {x} {z}</CgPoint>' for n, (x, y, z) in KNOWN.items()
    )
    rows = "\n".join(
        f'<RawObservation horizAngle="{s.direction / GON:.9f}" zenithAngle="{s.zenith / GON:.9f}" '
        f'slopeDistance="{s.distance:.6f}" targetHeight="{TARGET}">'
        f'<TargetPoint name="{s.target}" pntRef="{s.target}"/></RawObservation>'
        for s in sights()
    )
    setup = f'id="s1" stationName="S" instrumentHeight="{HEIGHT}"'
    if hexml:
        survey = f"<InstrumentSetup {setup}><InstrumentPoint/>\n{rows}\n</InstrumentSetup>"
    else:
        survey = f'<InstrumentSetup {setup}/><ObservationGroup id="o" setupID="s1">\n{rows}\n'
        survey += "</ObservationGroup>"
    more = '<HexagonLandXML xmlns="http://xml.hexagon.com/schema/HeXML-1.3"><Point uniqueID="A"/>'
    more += "</HexagonLandXML>"
    return (
        '<?xml version="1.0"?>\n<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2">\n'
        '<Units><Metric linearUnit="meter" angularUnit="grads"/></Units>\n'
        f"<CgPoints>\n{points}\n</CgPoints>\n<Survey>{survey}</Survey>\n{more if hexml else ''}"
        "</LandXML>\n"
    )


MAPPING = {
    "decimal": ",",
    "points": {"file": "points.csv", "name": "Punkt", "x": "Rechts", "y": "Hoch", "z": "H"},
    "readings": {
        "station": "=S",
        "target": "Ziel",
        "direction": "Hz",
        "zenith": "V",
        "distance": "S",
        "instrument_height": "=1.5",
        "target_height": "th",
    },
}
"""Mapping of `columns`."""
MAPPING_FILE = """decimal = ","

[points]
file = "points.csv"
name = "Punkt"
x = "Rechts"
y = "Hoch"
z = "H"

[readings]
station = "=S"
target = "Ziel"
direction = "Hz"
zenith = "V"
distance = "S"
instrument_height = "=1.5"
target_height = "th"
"""
"""The same as a file."""


def columns() -> dict[str, str]:
    """Return the survey as two tables with semicolons and decimal commas, by name of file."""
    rows = [
        f"{s.target};{s.direction / GON:.9f};{s.zenith / GON:.9f};{s.distance:.6f};{TARGET};x"
        for s in sights()
    ]
    points = [f"{n};{x};{y};{z}" for n, (x, y, z) in KNOWN.items()]
    return {
        "book.csv": "\n".join(["Ziel;Hz;V;S;th;Bemerkung", *rows]).replace(".", ",") + "\n",
        "points.csv": "\n".join(["Punkt;Rechts;Hoch;H", *points]).replace(".", ",") + "\n",
    }


HELD = {"fixed": "A,B,C", "refraction": None}
"""Options: points that are held, and a flat Earth."""
LANDXML_UNREAD = (
    r"ObservationGroup id=|pntRef=|InstrumentSetup id=|\|value\|A\|",
    r"Hexagon",
)
EXAMPLE_FILES = {
    "gsi": Example("gsi", lambda _: {"book.gsi": gsi()}, "book.gsi", HELD, is_field_book=True),
    "sdr33": Example(
        "sdr33",
        lambda _: {"book.sdr": sdr33()},
        "book.sdr",
        HELD,
        unread=(
            r"\|00NM|\|10NM|\|01NM",  # header without options, job, instrument
            r"\|value\|control\||\|word\|",  # descriptions behind the fields
        ),
        is_field_book=True,
    ),
    "jobxml": Example(
        "jobxml",
        lambda _: {"book.jxl": jobxml()},
        "book.jxl",
        HELD,
        unread=(r"<JOBFile version|<PointRecord ID=|\|value\|x\|",),
        open_names=True,
        is_field_book=True,
    ),
    "landxml": Example(
        "landxml",
        lambda _: {"book.xml": landxml()},
        "book.xml",
        HELD,
        unread=LANDXML_UNREAD,
        open_names=True,
        is_field_book=True,
    ),
    "hexml": Example(
        "landxml",
        lambda _: {"book.hexml": landxml(hexml=True)},
        "book.hexml",
        HELD,
        unread=LANDXML_UNREAD,
        open_names=True,
        is_field_book=True,
    ),
    "columns": Example(
        "columns",
        lambda _: {**columns(), "mapping.toml": MAPPING_FILE},
        "book.csv",
        HELD,
        {"mapping": "mapping.toml"},
        unread=(
            r"Bemerkung|\|value\|x\|",  # columns that are not mapped
            r"\|word\|;qz7x\|(Ziel|Punkt)",
            r"mapping\.toml\|value\|=\|",
        ),
        is_field_book=True,
    ),
}


def left_out_but_notes(network: Network) -> list[LeftOut]:
    """Return what a network has left out, without the notes of its file."""
    return [left for left in network.left_out if left.what != NOTES.what]
