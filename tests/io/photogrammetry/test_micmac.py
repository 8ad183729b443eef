"""MicMac: its own formula of distortion, and a block of ground control."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.rotation import world_R_camera
from tests.networks.pixel_block import projected

CALIBRATION = """<?xml version="1.0" ?>
<ExportAPERO><CalibrationInternConique>
<KnownConv>eConvApero_DistM2C</KnownConv>
<PP>3089.03 2025.24</PP><F>8668.7</F><SzIm>6080 4048</SzIm>
<CalibDistortion><ModPhgrStd><RadialePart><CDist>3023.45 2048.55</CDist>
<CoeffDist>-1.779e-09</CoeffDist><CoeffDist>1.773e-17</CoeffDist><CoeffDist>3.59e-25</CoeffDist>
</RadialePart><P1>3.79e-08</P1><P2>-1.03e-08</P2><b1>1.6e-4</b1><b2>2.5e-5</b2>
</ModPhgrStd></CalibDistortion>
</CalibrationInternConique></ExportAPERO>
"""
ORIENTATION = """<?xml version="1.0" ?>
<ExportAPERO><OrientationConique>
<OrIntImaM2C><I00>0 0</I00><V10>1 0</V10><V01>0 1</V01></OrIntImaM2C>
<TypeProj>eProjStenope</TypeProj>
<FileInterne>Ori-X/AutoCal_Foc-50000.xml</FileInterne><RelativeNameFI>true</RelativeNameFI>
<Externe><AltiSol>0</AltiSol><KnownConv>eConvApero_DistM2C</KnownConv>
<Centre>{centre}</Centre><ParamRotation><CodageMatr><L1>{0}</L1><L2>{1}</L2><L3>{2}</L3>
</CodageMatr></ParamRotation></Externe>
<ConvOri><KnownConv>eConvApero_DistM2C</KnownConv></ConvOri>
</OrientationConique></ExportAPERO>
"""
CENTRES = ((0.0, 0.0, 80.0), (15.0, 2.0, 82.0), (3.0, 14.0, 79.0))
TURNS = ((0.05, -0.1, 0.1), (-0.1, 0.15, 1.7), (0.1, 0.1, -1.5))
POINTS = {
    f"G{i}": (x, y, 0.1 * x - 0.05 * y)
    for i, (x, y) in enumerate((x, y) for x in (-6.0, 5.0, 16.0) for y in (-5.0, 6.0, 15.0))
}


def ideal(m: np.ndarray) -> np.ndarray:
    """Return corrected pixels of measured ones, as MicMac's cDistModStdPhpgr::Direct does."""
    q = m - (3023.45, 2048.55)
    x, y = q[:, 0], q[:, 1]
    r2 = x * x + y * y
    radial = -1.779e-09 * r2 + 1.773e-17 * r2**2 + 3.59e-25 * r2**3
    p1, p2, b1, b2 = 3.79e-08, -1.03e-08, 1.6e-4, 2.5e-5
    dx = (2 * x * x + r2) * p1 + 2 * x * y * p2 + b1 * x + b2 * y
    dy = (2 * y * y + r2) * p2 + 2 * x * y * p1
    return m + q * radial[:, None] + np.stack([dx, dy], 1)


def measured(shot: int) -> np.ndarray:
    """Return the pixels that MicMac's model measures of the points, y down."""
    rotation = world_R_camera(*TURNS[shot])
    q = (np.array(list(POINTS.values())) - CENTRES[shot]) @ rotation
    wanted = np.array((3089.03, 2025.24)) + 8668.7 * q[:, :2] / q[:, 2:]
    m = wanted.copy()
    for _ in range(50):
        m += wanted - ideal(m)
    return m


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    ori = tmp_path / "Ori-X"
    ori.mkdir()
    (ori / "AutoCal_Foc-50000.xml").write_text(CALIBRATION, encoding="utf-8")
    control, images = [], []
    for i, (at, turn) in enumerate(zip(CENTRES, TURNS, strict=True)):
        rows = [" ".join(map(repr, r)) for r in world_R_camera(*turn).tolist()]
        text = ORIENTATION.format(*rows, centre=" ".join(map(repr, at)))
        (ori / f"Orientation-{i}.tif.xml").write_text(text, encoding="utf-8")
        seen = "".join(
            f"<OneMesureAF1I><NamePt>{n}</NamePt><PtIm>{x!r} {y!r}</PtIm></OneMesureAF1I>"
            for n, (x, y) in zip(POINTS, measured(i).tolist(), strict=True)
        )
        images.append(
            f"<MesureAppuiFlottant1Im><NameIm>{i}.tif</NameIm>{seen}</MesureAppuiFlottant1Im>"
        )
    for name, at in list(POINTS.items())[:6]:
        sigma = "-1 -1 -1" if name == "G5" else "0.01 0.01 0.02"
        xyz = " ".join(map(repr, at))
        inner = f"<Pt>{xyz}</Pt><NamePt>{name}</NamePt><Incertitude>{sigma}</Incertitude>"
        control.append(f"<OneAppuisDAF>{inner}</OneAppuisDAF>")
    (tmp_path / "control.xml").write_text(
        f"<DicoAppuisFlottant>{''.join(control)}</DicoAppuisFlottant>", encoding="utf-8"
    )
    whole = f"<SetOfMesureAppuisFlottants>\n{''.join(images)}\n</SetOfMesureAppuisFlottants>"
    (tmp_path / "measures.xml").write_text(whole, encoding="utf-8")
    return ori


def read(folder: Path, **options: object) -> fga.Network:
    control, measures = folder.parent / "control.xml", folder.parent / "measures.xml"
    return fga.read(folder, control=control, measures=measures, **options)


def test_the_distortion_is_that_of_micmac(folder: Path) -> None:
    """Residuals of error-free measurements: ideal pixels agree to 1e-9 px, at every corner."""
    network = read(folder)
    assert len(network.photos) == 3 and network.n_image_points == 27
    for name, at in list(POINTS.items())[6:]:
        del network.points[name]
        network.points[name] = fga.Point(name, at)
    network.point_number = {n: i for i, n in enumerate(network.points)}
    from factorgraph_adj.graph.equations import compile_network

    equations = compile_network(network)
    block = next(b for b in equations.blocks if b.kind == "image")
    state = dict(equations.unknowns.start())
    check = list(network.points).index("G5")
    state["point"] = state["point"].copy()
    state["point"][check] = POINTS["G5"]
    v = equations.residuals(state)[block.rows]
    assert np.abs(v).max() < 1e-7


def test_ground_control_is_adjusted(folder: Path) -> None:
    network = read(folder, sigma_px=0.5, sigma_control=2.0)
    assert network.points["G5"].check == pytest.approx(POINTS["G5"])
    control = next(iter(network.observations.values()))
    assert isinstance(control, fga.ControlPoint) and control.sigma == (0.02, 0.02, 0.04)
    solution = fga.adjust(network)
    assert solution.converged and solution.sigma0 < 1e-3
    for name, at in POINTS.items():
        assert solution.point(name) == pytest.approx(at, abs=1e-6)


def test_parameters_that_are_named_are_unknown(folder: Path) -> None:
    camera = read(folder, calibration=["c", "k1"]).cameras["Foc-50000"]
    free = {n for n, held in zip(camera.lens.names, camera.fixed, strict=True) if not held}
    assert free == {"c", "k1"}
    assert projected(read(folder), ["G0"])["0.tif"].shape == (1, 2)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("Ori-X/AutoCal_Foc-50000.xml", "DistM2C", "DistC2M", "convention 'eConvApero_DistC2M'"),
        ("Ori-X/AutoCal_Foc-50000.xml", "ModPhgrStd", "ModUnif", "distortion <ModUnif> cannot"),
        ("Ori-X/AutoCal_Foc-50000.xml", "<F>8668.7", "<F>-1", "<F> must be greater than zero"),
        ("Ori-X/Orientation-1.tif.xml", "<I00>0 0", "<I00>1 0", "1.tif.xml:3: an inter"),
        ("Ori-X/Orientation-1.tif.xml", "<L1>", "<L1>9", "<CodageMatr> is no rotation matrix|numb"),
        ("measures.xml", "<NameIm>0", "<NameIm>9", r"measures\.xml:2: image '9\.tif' has no or"),
        ("control.xml", "<Pt>-6.0", "<Pt>x", r"control\.xml:1: <Pt>: 'x' is not a number"),
    ],
)
def test_wrong_files_are_refused(folder: Path, file: str, old: str, new: str, message: str) -> None:
    path = folder.parent / file
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read(folder)
