"""A small project as text, to be broken in one place, and helpers to write projects."""

from __future__ import annotations

from pathlib import Path

PROJECT = """\
name = "yard"

[units]
angle = "gon"

[[camera]]
name = "cam"
lens = { model = "harmonic", reference_radius = 50.0 }
unit = "mm"
sigma_um = 5
[camera.parameters]
c = 100.0
x0 = { value = 0.01, sigma = 0.02 }

[sigma.slope_distance]
sigma_mm = 2
ppm = 1

[sigma.zenith_angle]
sigma_mgon = 1
"""
POINTS = """\
name,x,y,z,fixed
A,0,0,0,xyz
B,10,0,0,xyz
C,5.01,8,1,
D,2,6.01,0.5,
E,8,6,0.7,
F,5,5,3,
"""
PHOTOS = """\
name,camera,x,y,z,omega,phi,kappa
P,cam,5,-10,1,100,0,0
"""
IMAGES = """\
photo,point,x,y
P,A,-50,-10
P,B,50,-10
P,C,0,0
P,D,-18.75,-3.125
P,E,18.75,-1.875
P,F,0,13.3
"""
OBSERVATIONS = """\
kind,id,station,target,value,sigma_mm,sigma_mgon
slope_distance,1,A,C,9.487,,
slope_distance,2,B,C,9.487,,
slope_distance,3,A,D,6.344,1.5,
slope_distance,4,B,D,10.012,,
slope_distance,5,A,E,10.024,,
slope_distance,6,B,E,6.363,,
zenith_angle,7,A,C,93.3,,
zenith_angle,8,A,D,95.0,,2
zenith_angle,9,B,E,93.0,,
slope_distance,10,A,F,7.681,,
slope_distance,11,B,F,7.681,,
direction,12,A,C,0,,1
direction,13,A,D,380,,1
direction,14,A,B,64,,1
"""
FILES = {
    "project.toml": PROJECT,
    "points.csv": POINTS,
    "photos.csv": PHOTOS,
    "images.csv": IMAGES,
    "observations.csv": OBSERVATIONS,
}
"""A project in which nothing is wrong."""


def write(folder: Path, files: dict[str, str] = FILES, **changed: str) -> Path:
    """Write a project; return its TOML file. ``points="…"`` replaces points.csv."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(changed.get(name.partition(".")[0], text), encoding="utf-8")
    for name, text in changed.items():
        if not any(f.startswith(f"{name}.") for f in files):
            (folder / f"{name}.csv").write_text(text, encoding="utf-8")
    return folder / "project.toml"
