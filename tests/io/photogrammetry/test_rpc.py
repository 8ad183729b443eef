"""RPC files: four grammars of the same numbers, and files that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.photogrammetry.rpc import add_rpc_image
from factorgraph_adj.models.rpc_lens import POLYNOMIALS, RpcLens
from tests.hostile.examples import Example

OFFSETS = {"line": 5000.0, "samp": 6000.0, "lat": -34.9, "long": -56.17, "height": 28.0}
SCALES = {"line": 5001.0, "samp": 6001.0, "lat": 0.066, "long": 0.07, "height": 82.0}
UNITS = {"line": "pixels", "samp": "pixels", "lat": "degrees", "long": "degrees"}
_RNG = np.random.default_rng(2)
COEFFICIENTS = {
    p: [1.0 if p.endswith("den") else 0.001, *_RNG.normal(0.0, 0.003, 19).round(9).tolist()]
    for p in POLYNOMIALS
}
COEFFICIENTS["line_num"][2], COEFFICIENTS["samp_num"][1] = -1.1, 1.05


def rpb() -> str:
    lines = ['satId = "XX01";', 'bandId = "P";', 'SpecId = "RPC00B";', "BEGIN_GROUP = IMAGE"]
    lines += ["\terrBias = 3.1;", "\terrRand = 0.4;"]
    lines += [f"\t{a}Offset = {v};" for a, v in OFFSETS.items()]
    lines += [f"\t{a}Scale = {v};" for a, v in SCALES.items()]
    for p, values in COEFFICIENTS.items():
        name = p[:4] + p[5:].capitalize() + "Coef"
        lines.append(f"\t{name} = (\n" + ",\n".join(f"\t\t\t{v:+.9E}" for v in values) + ");")
    return "\n".join([*lines, "END_GROUP = IMAGE", "END;", ""])


def text() -> str:
    lines = [
        f"{a.upper()}_{part}: {v:+.8f} {UNITS.get(a, 'meters')}"
        for part, values in (("OFF", OFFSETS), ("SCALE", SCALES))
        for a, v in values.items()
    ]
    lines += [
        f"{p.upper()}_COEFF_{i}: {v:+.12E}"
        for p, values in COEFFICIENTS.items()
        for i, v in enumerate(values, 1)
    ]
    return "\n".join([*lines, "ERR_BIAS: 3.1 meters", "ERR_RAND: 0.4 meters", ""])


def dimap() -> str:
    inverse = "\n".join(
        f"<{p.upper()}_COEFF_{i}>{v!r}</{p.upper()}_COEFF_{i}>"
        for p, values in COEFFICIENTS.items()
        for i, v in enumerate(values, 1)
    )
    validity = "\n".join(
        f"<{a.upper()}_{part}>{v + (part == 'OFF' and a in ('line', 'samp'))}</{a.upper()}_{part}>"
        for part, values in (("OFF", OFFSETS), ("SCALE", SCALES))
        for a, v in values.items()
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<Dimap_Document>
<Metadata_Identification>
<METADATA_PROFILE>PHR_SENSOR</METADATA_PROFILE>
</Metadata_Identification>
<Rational_Function_Model>
<Resource_Reference>
<RESOURCE_ID>RPC00B</RESOURCE_ID>
</Resource_Reference>
<Global_RFM>
<Inverse_Model>
{inverse}
</Inverse_Model>
<RFM_Validity>
{validity}
</RFM_Validity>
</Global_RFM>
</Rational_Function_Model>
</Dimap_Document>
"""


def isd() -> str:
    inside = [
        f"<{a.upper()}{part}>{v!r}</{a.upper()}{part}>"
        for part, values in (("OFFSET", OFFSETS), ("SCALE", SCALES))
        for a, v in values.items()
    ]
    for p, values in COEFFICIENTS.items():
        tag = (p[:4] + p[5:] + "coef").upper()
        inside.append(f"<{tag}List>\n<{tag}>{' '.join(map(repr, values))}</{tag}>\n</{tag}List>")
    body = "\n".join(inside)
    return f"<isd>\n<RPB>\n<SPECID>RPC00B</SPECID>\n<IMAGE>\n{body}\n</IMAGE>\n</RPB>\n</isd>\n"


FILES = {"scene.rpb": rpb, "scene_RPC.TXT": text, "RPC_scene.XML": dimap, "scene.XML": isd}
EXAMPLE_FILES = {
    "RPB": Example(
        "rpc",
        {"scene.rpb": rpb()},
        "scene.rpb",
        unread=(r"satId|bandId|errBias|errRand|BEGIN_GROUP|END_GROUP|END;|scene\.rpb\|add",),
        places_only=True,
    ),
    "text": Example(
        "rpc",
        {"scene_RPC.TXT": text()},
        "scene_RPC.TXT",
        unread=("ERR_BIAS|ERR_RAND",),
        places_only=True,
    ),
    "DIMAP": Example(
        "rpc", {"RPC_scene.XML": dimap()}, "RPC_scene.XML", open_names=True, places_only=True
    ),
    "isd": Example("rpc", {"scene.XML": isd()}, "scene.XML", open_names=True, places_only=True),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, make in FILES.items():
        (tmp_path / name).write_text(make())
    return tmp_path


@pytest.mark.parametrize("name", FILES)
def test_every_grammar_has_the_same_camera(folder: Path, name: str) -> None:
    """Half a pixel leads from the centre of the first pixel to its corner."""
    network = fga.read(folder / name)
    (camera,) = network.cameras.values()
    found = dict(zip(camera.lens.names, camera.values, strict=True))
    assert isinstance(camera.lens, RpcLens) and all(camera.fixed)
    for a in OFFSETS:
        shift = 0.5 if a in ("line", "samp") else 0.0
        assert found[f"{a}_off"] == pytest.approx(OFFSETS[a] + shift, abs=1e-9)
        assert found[f"{a}_scale"] == pytest.approx(SCALES[a], abs=1e-9)
    for p, values in COEFFICIENTS.items():
        assert [found[f"{p}_{i}"] for i in range(1, 21)] == pytest.approx(values, abs=1e-11)
    assert camera.format == (12001.5, 10001.5)
    assert all(network.photos[camera.name].fixed)


def test_images_of_several_files_are_one_network(folder: Path) -> None:
    network = fga.Network(frame=fga.TopocentricFrame(-0.61, -0.98))
    for name in FILES:
        add_rpc_image(network, folder / name, name=name, free=("x0",), sigma_shift_px=5.0)
    assert list(network.photos) == list(FILES)
    camera = network.cameras["scene.rpb"]
    assert [n for n, held in zip(camera.lens.names, camera.fixed, strict=True) if not held] == [
        "x0",
        "y0",
    ]
    assert camera.sigma[1:3] == (np.inf, 5.0)


@pytest.mark.parametrize(
    ("name", "old", "new", "why"),
    [
        ("scene.rpb", "RPC00B", "RPC00A", "3: SpecId must be RPC00B"),
        ("scene.rpb", "latScale = 0.066", "latScale = 0", "lat_scale|latScale must not be zero"),
        ("scene.rpb", "latScale", "latScall", "unknown name 'latScall'"),
        ("scene.rpb", "5000.0;", "5000.0;\n\tlineOffset = 1;", "lineOffset stands twice"),
        ("scene_RPC.TXT", "pixels", "metres", "1: LINE_OFF must be a number and perhaps pixels"),
        ("scene_RPC.TXT", "LINE_NUM_COEFF_7", "LINE_NUM_COEFF_21", "unknown name"),
        ("RPC_scene.XML", "PHR_SENSOR", "PNEO_SENSOR", "must be one of PHR_SENSOR"),
        ("RPC_scene.XML", "<LAT_OFF>", "<LAT_OFF>x", "LAT_OFF"),
        ("scene.XML", "5000.0", "", "LINEOFFSET"),
    ],
)
def test_wrong_file_is_refused_with_its_line(folder, name, old, new, why) -> None:
    path = folder / name
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(fga.InputError, match=why):
        fga.read(path)


def test_coefficients_are_not_free(folder: Path) -> None:
    with pytest.raises(fga.InputError, match="free must be some of c, x0"):
        add_rpc_image(fga.Network(), folder / "scene.rpb", free=("line_num_1",))
