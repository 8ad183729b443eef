"""Small files of surveying and GNSS programs, all undamaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from tests.hostile.examples import Example

SINEX = """%=SNX 2.02 XXX 20:001:00000 XXX 20:001:00000 20:001:00000 C 00006 0 S
*-------------------------------------------------------------------------------
+SOLUTION/ESTIMATE
*INDEX TYPE__ CODE PT SOLN _REF_EPOCH__ UNIT S __ESTIMATED VALUE____ _STD_DEV___
     1 STAX   AAAA  A    1 20:001:00000 m    2 0.400000000000000E+07 .200000E-02
     2 STAY   AAAA  A    1 20:001:00000 m    2 0.100000000000000E+07 .100000E-02
     3 STAZ   AAAA  A    1 20:001:00000 m    2 0.480000000000000E+07 .300000E-02
     4 TROTOT AAAA  A    1 20:001:00000 m    2 0.240000000000000E+01 .100000E-02
-SOLUTION/ESTIMATE
+SOLUTION/MATRIX_ESTIMATE L COVA
     1     1  0.40000000000000E-05
     2     1  0.10000000000000E-05  0.10000000000000E-05
     3     1  0.00000000000000E+00  0.00000000000000E+00  0.90000000000000E-05
     4     3  0.20000000000000E-05  0.10000000000000E-05
-SOLUTION/MATRIX_ESTIMATE L COVA
%ENDSNX
"""
LGC2 = """*TITR
a small network
*OLOC
*PREC 6
*INSTR
*POLAR T P1 0 0 0
P1 5 7 0.1 2 0 0 0 0
*SCALE R 0.2 0 0.01 0 0
*CALA
A 0 0 0
B 100 0 0
*VXY
C 50.0 80.0 1.0 % a comment
*FRAME F 0 0 0 0 0 0 1 TX TY TZ RX RY RZ
*CALA
E 1 2 3
*OBSXYZ
E 1 2 3 0.1 0.1 0.1
*ENDFRAME
*POIN
D 20.0 30.0 2.0
*TSTN A T IHFIX
*V0
*ANGL
B 100.0
C 35.6
D 37.43
*ZEND
C 99.3
D 96.5
*DIST
C 94.345
D 36.111
*ECSP A B R
D 30.06
*END
"""
COMP3D = {
    "net.cor": """* the net
1 S1 100.000 100.000 50.000 0.001 0.001 0.001 *comment
2 S2 150.000 100.000 50.000 0.010 0.010 0.000
3 S3 100.000 150.000 50.000 0.000 0.000 0.001
1 F1 150.000 150.000 51.000 0 0 0
-1 OUT
@more.cor
""",
    "more.cor": "0 T1 130.000 140.000 52.000\n",
    "net.obs": """*code origin target value sigma_abs sigma_rel h_station h_target
7 S1 S2 100.0000 0.0010 0.001
5 S1 S3 0.0000 0.0010 0.000 1.500 1.600
6 S1 T1 96.0000 0.0010
3 S1 T1 50.0400 0.001 0.0001
1 S1 F1 70.7180 0.002
8 S1 S2 100.0000 0.0010
4 S2 F1 1.600 0.001
@inner.obs
12 S1 @polar.xyz
22 @pairs.eq
""",
    "inner.obs": "3 S3 T1 31.7000 0.002\n",
    "polar.xyz": "S2 300.0000 0.0000 50.0000 0.0010 0.0005 0.0010 0.0001 0.000\n"
    "T1 20.0 0.0 0.0 0.0010 -1 0.0001\n",
    "pairs.eq": "S1 S2 0.001\nS1 S3 0.002\n",
}
STAR_NET = """# a traverse
.UNITS Meters GONS
C A 100.000 200.000 10.000 ! ! !   # held
C B 400.000 250.000 12.000 ! ! *
C P 250.000 300.000 11.000
DB A
DN B 10.0000 3.0
DN P 350.0000
DE
M A-B-P 59.1234 180.278 99.5000 1.50/1.60 'a point
A B-A-P 40.1234
D A-P 180.278 0.003
L A-P 1.0021 0.180
V B-P 100.1234
B A-P 62.5666
"""
STAR_NET_OPTIONS = {
    "adjustment": "3D",
    "linear": "Meters",
    "angular": "GONS",
    "order": "NE",
    "stations": "AtFromTo",
    "distances": "slope",
    "angle": 4.0,
    "direction": 3.0,
    "azimuth": 5.0,
    "zenith": 10.0,
    "distance": 0.0075,
    "distance_ppm": 2.0,
    "elevation": 0.02,
    "elevation_ppm": 0.0,
    "level": 0.025,
    "weight_levels_by": "length",
    "centring_instrument": 0.005,
    "centring_target": 0.005,
    "centring_vertical": 0.0,
    "refraction": 0.07,
}
LEVELS = """410001+?......2
110002+0000000A 83..08+00000000
110003+0000000A 32...8+02000000 331.08+00150000
110004+0000000B 32...8+02100000 332.08+00120000
110005+0000000B 32...8+02100000 336.08+00120010
110006+0000000A 32...8+02000000 335.08+00150030
110007+0000000B 83..08+00030000
410008+?......1
110009+0000000B 32...8+02000000 331.08+00110000
110010+0000000X 32...8+01000000 333.08+00100000
110011+0000000A 32...8+02000000 332.08+00140010
"""


def _station(name: str, latitude: str, longitude: str, height: float, held: str) -> str:
    return (
        f"<DnaStation>\n<Name>{name}</Name>\n<Constraints>{held}</Constraints><Type>LLh</Type>\n"
        f"<StationCoord><Name>{name}</Name><XAxis>{latitude}</XAxis><YAxis>{longitude}</YAxis>\n"
        f"<Height>{height}</Height></StationCoord>\n<Description/>\n</DnaStation>\n"
    )


def _measurement(kind: str, inside: str) -> str:
    return f"<DnaMeasurement>\n<Type>{kind}</Type><Ignore/>\n{inside}\n</DnaMeasurement>\n"


def dynaml() -> dict[str, bytes]:
    """Return a combined file of three stations."""
    baseline = (
        "<X>1.5</X><Y>2.5</Y><Z>3.5</Z>\n<SigmaXX>4e-6</SigmaXX><SigmaXY>1e-6</SigmaXY>"
        "<SigmaXZ>0</SigmaXZ><SigmaYY>4e-6</SigmaYY><SigmaYZ>0</SigmaYZ><SigmaZZ>9e-6</SigmaZZ>"
    )

    def sight(kind: str, second: str, value: str, sigma: float, more: str = "") -> str:
        return _measurement(
            kind,
            f"<First>A</First><Second>{second}</Second>{more}<Value>{value}</Value>\n"
            f"<StdDev>{sigma}</StdDev><InstHeight>1.5</InstHeight><TargHeight>1.6</TargHeight>",
        )

    def of_station(kind: str, value: str, sigma: float) -> str:
        inside = f"<First>C</First><Value>{value}</Value><StdDev>{sigma}</StdDev>"
        return _measurement(kind, inside)

    directions = "".join(
        f"<Directions><Ignore/><Target>{t}</Target><Value>{v}</Value><StdDev>1.5</StdDev>"
        "</Directions>\n"
        for t, v in (("B", "0.0000"), ("C", "30.1500"))
    )
    text = [
        '<?xml version="1.0"?>\n<DnaXmlFormat type="Combined File" referenceframe="GDA2020">\n',
        _station("A", "-36.3000", "145.5700", 100.0, "CCC"),
        _station("B", "-36.2959", "145.5730", 110.0, "CCF"),
        _station("C", "-36.3030", "145.5745", 120.0, "FFF"),
        _measurement(
            "G",
            "<First>A</First><Second>B</Second><Vscale>2</Vscale>\n"
            f"<GPSBaseline>{baseline}</GPSBaseline>",
        ),
        sight("S", "C", "1000.125", 0.003),
        sight("V", "C", "91.1530123", 2.0),
        sight("B", "C", "123.30305", 1.0),
        sight("A", "B", "30.1500", 1.0, "<Third>C</Third>"),
        _measurement(
            "D",
            "<First>C</First><Second>A</Second><Value>0.0000</Value><StdDev>1.0</StdDev>"
            "<Total>1</Total>\n" + directions.split("\n")[0],
        ),
        of_station("R", "120.25", 0.01),
        of_station("P", "-36.3030", 0.5),
        of_station("Q", "145.5745", 0.5),
        "</DnaXmlFormat>\n",
    ]
    return {"combined.xml": "".join(text).encode()}


def gvx(folder: Path) -> dict[str, bytes]:
    """Return a single vector and a session of two."""
    n = fga.Network("n", frame=fga.GeocentricFrame())
    for name, at in (("A", (0, 0)), ("B", (100, 200)), ("C", (0, 300))):
        n.add_point(name, (4e6 + at[0], 1e6 + at[1], 4.8e6))
    one = np.array([[4e-6, 1e-6, 0], [1e-6, 4e-6, 2e-6], [0, 2e-6, 9e-6]])
    n.add(fga.GnssVector("A", "B", (100.001, 200.002, -0.003), covariance=one, id="alone"))
    two = (
        fga.GnssVector("A", "C", (0.0, 300.0, 0.0), covariance=one, id="first"),
        fga.GnssVector("B", "C", (-100.0, 100.0, 0.0), covariance=one, id="second"),
    )
    from factorgraph_adj.observations import Correlated

    n.add(Correlated(two, np.kron([[1.0, 0.4], [0.4, 1.0]], one)))
    fga.write_gvx(n, folder / "n.gvx", reference_system_id=126, reference_system="NAD 83(2011)")
    return {"n.gvx": (folder / "n.gvx").read_bytes()}


MMVII = {
    "coords.txt": """* 0 is a free point
1 A 100.0 100.0 10.0
1 B 160.0 100.0 12.0 * given
0 C 130.0 150.0 11.0
""",
    "meas.obs": """ 7 A B 100.0000 0.0010
 5 A C 34.4042 0.0010 * clockwise
 6 A C 98.9085 0.0010
 3 A C 58.3180 0.0020
 4 A C 1.0 0.001
 3 B C 58.3180 -1
#NEW
 5 A B 0.0 0.001
 5 A C 334.4042 0.001
#FIX
 5 B C 365.5958 0.001
 14 B C -30.001 0.005
 15 B C 50.002 0.005
 16 B C -1.0 0.005
""",
}
"""A survey of MMVII: points, observations."""


EXAMPLE_FILES = {
    "star-net": Example(
        "star-net",
        {"job.dat": STAR_NET},
        "job.dat",
        {"options": STAR_NET_OPTIONS},
        unread=(r"\|#|#   held|# held", r"'a point"),
    ),
    "gsi of levels": Example("gsi", {"levels.gsi": LEVELS}, "levels.gsi", {"fixed": "A"}),
    "sinex": Example(
        "sinex",
        {"small.snx": SINEX},
        "small.snx",
        unread=(
            r"\|%=SNX|\|\*",  # header, comments
            r"\|value\|2\||TROTOT",  # kind of constraint, parameters that are no coordinates
            r"\|-SOLUTION/MATRIX|%ENDSNX",
        ),
    ),
    "dynaml": Example(
        "dynaml",
        lambda _: dynaml(),
        "combined.xml",
        unread=(r"type=\"Combined", r"\|attribute\|", r"<Description"),
    ),
    "gvx": Example(
        "gvx",
        gvx,
        "n.gvx",
        unread=(
            r"SOURCE_DATA|REFERENCE_SYSTEM|EQUIPMENT|SURVEY_SETUP|EPOCH|GEODETIC|<SESSION ID",
            r"\|value\|unknown\|",
        ),
        open_names=True,
    ),
    "comp3d": Example(
        "comp3d",
        COMP3D,
        "net.obs",
        {"latitude": 48.8},
        unread=(r"\|\*|\*comment", r"\|-1 OUT"),
    ),
    "mmvii": Example(
        "mmvii",
        MMVII,
        "meas.obs",
        unread=(r"\|\*|\* (given|clockwise)", r" -1$"),  # comments; what is switched off
    ),
    "lgc2": Example(
        "lgc2",
        {"net.lgc2": LGC2},
        "net.lgc2",
        unread=(
            # Title, printing; a plane is the default.
            r"\|a small network|\|\*TITR|\|\*PREC|\*OLOC$",
            r"% a comment",
            r"\*POLAR|\|P1 |\*SCALE",  # targets that are not used, further numbers of instruments
        ),
    ),
}
