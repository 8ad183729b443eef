"""A yard with two known points, and what is observed there as lines of a stream."""

from __future__ import annotations

PROJECT = """\
name = "yard"
[sigma.slope_distance]
sigma_mm = 2
[sigma.zenith_angle]
sigma_mgon = 1
[sigma.direction]
sigma_mgon = 1
[sigma.height_difference]
sigma_mm = 0.5
"""


POINTS = "name,x,y,z,fixed\nA,0,0,100,xyz\nB,80,0,101,xyz\nC,,,,\n"


YARD = {"project.toml": PROJECT, "points.csv": POINTS}


ARRIVALS = (
    {"kind": "direction", "id": "r1", "station": "A", "target": "B", "value": 0.0},
    {"kind": "direction", "id": "r2", "station": "A", "target": "C", "value": 334.4035},
    {"kind": "zenith_angle", "id": "z1", "station": "A", "target": "C", "value": 98.3621},
    {"kind": "slope_distance", "id": "s1", "station": "A", "target": "C", "value": 58.3268},
    {"kind": "slope_distance", "id": "s2", "station": "B", "target": "C", "value": 70.7141},
    {"kind": "zenith_angle", "id": "z2", "station": "B", "target": "C", "value": 99.5507},
    {"kind": "height_difference", "id": "h1", "station": "A", "target": "C", "value": 1.4996},
)


WRONG = {**ARRIVALS[4], "id": "s3", "value": 70.9}
