"""A network of three stations in DynaML, with every type of measurement that it reads there."""

from __future__ import annotations

from pathlib import Path

import factorgraph_adj as fga


def station(name: str, latitude: str, longitude: str, height: float, held: str = "FFF") -> str:
    return (
        f"<DnaStation><Name>{name}</Name><Constraints>{held}</Constraints><Type>LLh</Type>"
        f"<StationCoord><Name>{name}</Name><XAxis>{latitude}</XAxis><YAxis>{longitude}</YAxis>"
        f"<Height>{height}</Height></StationCoord><Description/></DnaStation>\n"
    )


def measurement(kind: str, inside: str) -> str:
    return f"<DnaMeasurement><Type>{kind}</Type><Ignore/>{inside}</DnaMeasurement>\n"


def sight(kind: str, first: str, second: str, value: str, sigma: float, more: str = "") -> str:
    return measurement(
        kind,
        f"<First>{first}</First><Second>{second}</Second>{more}<Value>{value}</Value>"
        f"<StdDev>{sigma}</StdDev><InstHeight>1.5</InstHeight><TargHeight>1.6</TargHeight>",
    )


def of_station(kind: str, name: str, value: str, sigma: float) -> str:
    return measurement(kind, f"<First>{name}</First><Value>{value}</Value><StdDev>{sigma}</StdDev>")


VECTOR = (
    "<X>1.5</X><Y>2.5</Y><Z>3.5</Z><SigmaXX>4e-6</SigmaXX><SigmaXY>1e-6</SigmaXY>"
    "<SigmaXZ>0</SigmaXZ><SigmaYY>4e-6</SigmaYY><SigmaYZ>0</SigmaYZ><SigmaZZ>9e-6</SigmaZZ>"
)
HEAD = '<?xml version="1.0"?>\n<DnaXmlFormat type="Combined File" referenceframe="GDA2020">\n'
STATIONS = (
    station("A", "-36.3000", "145.5700", 100.0, "CCC")
    + station("B", "-36.2959", "145.5730", 110.0, "CCF")
    + station("C", "-36.3030", "145.5745", 120.0)
)
MEASUREMENTS = "".join(
    [
        measurement("G", f"<First>A</First><Second>B</Second><Vscale>2</Vscale>"
                         f"<GPSBaseline>{VECTOR}</GPSBaseline>"),
        sight("S", "A", "C", "1000.125", 0.003),
        sight("V", "A", "C", "91.1530123", 2.0),
        sight("Z", "A", "C", "-1.1530123", 2.0),
        sight("B", "A", "C", "123.30305", 1.0),
        sight("A", "A", "B", "30.1500", 1.0, "<Third>C</Third>"),
        measurement("D", "<First>A</First><Second>B</Second><Value>0.0000</Value>"
                         "<StdDev>1.0</StdDev><Total>2</Total>"
                         "<Directions><Ignore/><Target>C</Target><Value>30.1500</Value>"
                         "<StdDev>1.5</StdDev></Directions>"
                         "<Directions><Ignore>*</Ignore><Target>B</Target><Value>1</Value>"
                         "<StdDev>1.5</StdDev></Directions>"),
        of_station("R", "C", "120.25", 0.01),
        of_station("P", "C", "-36.3030", 0.5),
        of_station("Q", "C", "145.5745", 0.5),
        of_station("I", "C", "-36.3031", 0.5),
        of_station("J", "C", "145.5746", 0.5),
        measurement("S", "<First>A</First>").replace("<Ignore/>", "<Ignore>*</Ignore>"),
    ]
)  # fmt: skip
TAIL = "</DnaXmlFormat>\n"


def read(folder: Path, text: str, **options: object) -> fga.Network:
    path = folder / "combined.xml"
    path.write_text(text, encoding="utf-8")
    return fga.read_dynaml(path, **options)  # type: ignore[arg-type]
