"""MMVII: its own formula of projection and distortion, published poses, ground control."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.rotation import world_R_camera
from tests.networks import photo_files

K = {"K1": -0.09977, "K2": 0.1106, "K3": 0.0197}
P = {"p1": -2.3e-4, "p2": 8.6e-4}
B = {"b1": -1.3e-3, "b2": 4.8e-4}
PP, F = np.array((856.867, 577.614)), 2112.218
CENTRES = ((0.0, 0.0, 30.0), (8.0, 1.0, 31.0), (1.0, 9.0, 29.0))
TURNS = ((0.05, -0.1, 0.1), (-0.1, 0.15, 1.7), (0.1, 0.1, -1.5))
POINTS = {
    f"G{i}": (x, y, 0.2 * x - 0.1 * y)
    for i, (x, y) in enumerate((x, y) for x in (-4.0, 3.0, 10.0) for y in (-4.0, 3.0, 9.0))
}


def tag(name: str, *values: object) -> str:
    """Return a line with an element."""
    return f"<{name}>{' '.join(map(str, values))}</{name}>\n"


def calibration(projection: str, degree: str, parts: dict[str, dict[str, float]]) -> str:
    """Return the contents of a calibration."""
    inner = "".join(
        f"<{part}>\n{''.join(tag(k, v) for k, v in values.items())}</{part}>\n"
        for part, values in parts.items()
    )
    return (
        '<InternalCalibration>\n<Name>"Calib-PerspCentral-Foc-28000"</Name>\n'
        "<PixelFrame><NbPix>1728 1152</NbPix></PixelFrame>\n"
        f'<Projection>"{projection}"</Projection>\n<Auxiliary>\n<SzBuffer>-1</SzBuffer>\n'
        f"<Degree>{degree}</Degree>\n<IsFraserMode>1</IsFraserMode>\n</Auxiliary>\n"
        f"<PerfectProj>\n<F>{F}</F>\n{tag('PP', *PP)}</PerfectProj>\n"
        f"<Distorsion>\n{inner}</Distorsion>\n</InternalCalibration>\n"
    )


def file(inner: str, *, old: bool = False) -> str:
    """Return a file of MMVII, of the older or the newer serialization."""
    head = '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n'
    if old:
        head = head.replace("UTF-8", "ISO8859-1")
        for name in ("InternalCalibration", "CameraPose"):
            inner = inner.replace(f"<{name}>", "").replace(f"</{name}>", "")
        return f"{head}<MMVII_Serialization>\n{inner}</MMVII_Serialization>\n"
    kind = '<Type>"MMVII_Serialization"</Type>\n<Version>"0.0.0"</Version>\n'
    return f"{head}<Root>\n{kind}<Data>\n{inner}</Data>\n</Root>\n"


def plane(projection: str, q: np.ndarray) -> np.ndarray:
    """Return MMVII's projections of rays (n, 3), as cProjStenope and the like do."""
    x, y, z = q.T
    r = np.hypot(x, y)
    if projection == "Stenope":
        return np.stack([x / z, y / z], 1)
    if projection == "EquiRect":
        return np.stack([np.arctan2(x, z), np.arcsin(y / np.linalg.norm(q, axis=1))], 1)
    return np.stack([x, y], 1) * (np.arctan2(r, z) / r)[:, None]


def distorted(u: np.ndarray, k: dict[str, float]) -> np.ndarray:
    """Return distorted coordinates, as cMMVIIUnivDist::PProjToImNorm does."""
    x, y = u.T
    r2 = x * x + y * y
    radial = sum(k.get(f"K{i}", 0.0) * r2**i for i in range(1, 5))
    p1, p2 = k.get("p1", 0.0), k.get("p2", 0.0)
    dec_x = p1 * (r2 + 2 * x * x) + p2 * 2 * x * y
    dec_y = p1 * 2 * x * y + p2 * (r2 + 2 * y * y)
    pol_x = k.get("b1", 0.0) * x + k.get("b2", 0.0) * y
    return np.stack([x + x * radial + dec_x + pol_x, y + y * radial + dec_y], 1)


CASES = {
    "Stenope": ("3 1 1", {"Radial": K, "Decentric": P, "Polynomial": B}),
    "FE_EquiDist": (
        "4 1 1",
        {"Radial": {**K, "K4": 0.003}, "Decentric": P, "Polynomial": {"b1": 0.0, "b2": 0.0}},
    ),
    "EquiRect": ("0 0 0", {}),
}


def block(folder: Path, projection: str = "Stenope", *, old: bool = False) -> Path:
    """Write a block of known truth; return the folder of orientations."""
    ori, marks = folder / "Ori-X", folder / "Marks"
    ori.mkdir()
    marks.mkdir()
    degree, parts = CASES[projection]
    k = {name: v for values in parts.values() for name, v in values.items()}
    text = file(calibration(projection, degree, parts), old=old)
    (ori / "Calib-PerspCentral-Foc-28000.xml").write_text(text, encoding="utf-8")
    for i, (at, turn) in enumerate(zip(CENTRES, TURNS, strict=True)):
        rotation = world_R_camera(*turn)
        axes = "".join(tag(n, *rotation[:, j].tolist()) for j, n in enumerate(("AxeI", "AxeJ")))
        axes += tag("AxeK", *rotation[:, 2].tolist())
        link = tag("NameInternalCalib", '"Calib-PerspCentral-Foc-28000"')
        pose = f'<CameraPose>\n<NameImage>"{i}.tif"</NameImage>\n{link}{tag("Center", *at)}'
        pose += f"<RotMatrix>\n{axes}</RotMatrix>\n</CameraPose>\n"
        (ori / f"Ori-PerspCentral-{i}.tif.xml").write_text(file(pose, old=old), encoding="utf-8")
        q = (np.array(list(POINTS.values())) - at) @ rotation
        pixels = (PP + F * distorted(plane(projection, q), k)).tolist()
        seen = "".join(
            f'<el>\n<Name>"{n}"</Name>\n{tag("Pt", *xy)}<Sigma2>1 0 4</Sigma2>\n</el>\n'
            for n, xy in zip(POINTS, pixels, strict=True)
        )
        count = tag("Nb", len(POINTS)) if old else ""
        text = f'<NameIm>"{i}.tif"</NameIm>\n<Measures>\n{count}{seen}</Measures>\n'
        text = file(f"<SetMesIm>\n{text}</SetMesIm>\n", old=old)
        (marks / f"MesIm-{i}.tif.xml").write_text(text, encoding="utf-8")
    variances = {"G3": "0 0 0 0 0 0", "G4": "4e-4 1e-4 0 4e-4 0 9e-4"}
    rows = ""
    for name, at in list(POINTS.items())[:6]:
        sigma = tag("Sigma2" if old else "__Opt__Sigma2", variances.get(name, "1e-4 0 0 1e-4 0 1"))
        rows += f'<el>\n<Name>"{name}"</Name>\n{tag("Pt", *at)}{"" if name == "G5" else sigma}'
        rows += "</el>\n"
    rows = f'<SetGCP>\n<NameSet>"X"</NameSet>\n<Measures>\n{rows}</Measures>\n</SetGCP>\n'
    (marks / "MesGCP-X.xml").write_text(file(rows, old=old), encoding="utf-8")
    return ori


def read(ori: Path, **options: object) -> fga.Network:
    marks = ori.parent / "Marks"
    return fga.read(ori, control=marks, measures=marks, **options)


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("projection", CASES)
def test_the_projection_and_distortion_are_those_of_mmvii(
    projection: str, old: bool, tmp_path: Path
) -> None:
    """Residuals of error-free measurements are below 1e-8 px, at every corner of the images."""
    network = read(block(tmp_path, projection, old=old))
    assert len(network.photos) == 3 and network.n_image_points == 27
    equations = compile_network(network)
    rows = next(b for b in equations.blocks if b.kind == "image").rows
    state = dict(equations.unknowns.start())
    state["point"] = np.array(list(POINTS.values()))
    assert list(network.points) == list(POINTS)
    v = equations.residuals(state)[rows]
    assert v.size == 54 and np.abs(v).max() < 1e-8


@pytest.mark.parametrize("name", ["Sigma2", "Opt:Sigma2", "__Opt__Sigma2"])
def test_ground_control_has_the_variances_of_the_file(name: str, tmp_path: Path) -> None:
    """MMVII named the variances in three ways."""
    ori = block(tmp_path)
    path = tmp_path / "Marks" / "MesGCP-X.xml"
    text = path.read_text(encoding="utf-8").replace("__Opt__Sigma2", name)
    path.write_text(text, encoding="utf-8")
    network = read(ori, sigma_control=2.0, sigma_px=0.5)
    control = {o.point: o for o in network.observations.values() if isinstance(o, fga.ControlPoint)}
    assert set(control) == {"G0", "G1", "G2", "G4"}
    assert control["G0"].sigma == pytest.approx((0.02, 0.02, 2.0))
    assert control["G4"].covariance == pytest.approx(
        4e-4 * np.array([[4, 1, 0], [1, 4, 0], [0, 0, 9.0]])
    )
    assert network.points["G3"].fixed == (True, True, True)
    assert network.points["G5"].coordinates == pytest.approx(POINTS["G5"])
    assert np.isnan(network.points["G8"].coordinates).all()
    assert network.images.columns()[3][0] == pytest.approx((0.5, 1.0))


def test_a_block_is_adjusted_to_its_truth_with_the_calibration_unknown(tmp_path: Path) -> None:
    network = read(block(tmp_path), calibration=["c", "k1"], sigma_control=0.1)
    camera = network.cameras["Foc-28000"]
    c, k1 = camera.lens.names.index("c"), camera.lens.names.index("k1")
    values = list(camera.values)
    values[c], values[k1] = values[c] + 3.0, values[k1] + 0.004
    network.cameras["Foc-28000"] = replace(camera, values=tuple(values))
    solution = fga.adjust(network)
    assert solution.converged and solution.sigma0 < 1e-5
    found = solution.as_network().cameras["Foc-28000"].values
    assert found[c] == pytest.approx(F, abs=1e-5) and found[k1] == pytest.approx(K["K1"], abs=1e-8)
    for name, at in POINTS.items():
        assert solution.point(name) == pytest.approx(at, abs=1e-6)


PUBLISHED = {
    "Ori-PerspCentral-IMGP4168.JPG.xml": """<CameraPose>
<NameImage>"IMGP4168.JPG"</NameImage>
<NameInternalCalib>"Calib-PerspCentral-Foc-28000_Cam-PENTAX_K5"</NameInternalCalib>
<Center>5.203315710339428 0.801558951120939 2.104233883945823</Center>
<RotMatrix>
<AxeI>-0.16360794707346 0.050533795937991 0.985230315775202</AxeI>
<AxeJ>0.115991824112041 0.992745533269003 -0.03165758856268</AxeJ>
<AxeK>-0.979682773347357 0.109099228423211 -0.168282565834643</AxeK>
</RotMatrix></CameraPose>""",
    "Calib-PerspCentral-Foc-28000_Cam-PENTAX_K5.xml": """<InternalCalibration>
<Name>"Calib-PerspCentral-Foc-28000_Cam-PENTAX_K5"</Name>
<PixelFrame><NbPix>1728 1152</NbPix></PixelFrame><Projection>"Stenope"</Projection>
<Auxiliary><SzBuffer>-1</SzBuffer><Degree>3 1 1</Degree><IsFraserMode>1</IsFraserMode></Auxiliary>
<PerfectProj><F>2112.217952097260422</F><PP>856.867008742109419 577.613650928660491</PP>
</PerfectProj><Distorsion>
<Radial><K1>-0.09976637812756</K1><K2>0.110628064042645</K2><K3>0.019690051934468</K3></Radial>
<Decentric><p1>-0.000000003177755</p1><p2>0.000000086257484</p2></Decentric>
<Polynomial><b1>-0.000001342233657</b1><b2>0.000000013881794</b2></Polynomial>
</Distorsion></InternalCalibration>""",
}
"""MicMac: MMVII/MMVII-TestDir/Input/Saisies-MMV1/MMVII-PhgrProj/Ori/toto."""
MARKED = {
    "I-of-I": ((0.754045221758524, 0.496427193197003, 0.431416432371162), (430.527, 227.090)),
    "Acute": ((0.898750585424819, 1.104095072492661, 0.444680581722014), (431.735, 510.223)),
    "Finger-1": ((1.317713337538785, 0.989188464947305, 0.370627429238322), (316.373, 471.678)),
    "Stone-6": ((0.150697933447584, 1.108183371793216, 0.773464897817899), (667.402, 479.732)),
    "Stone-7": ((0.256396378205514, 2.353187590216264, 2.238877852582342), (1284.051, 981.021)),
    "Grille": ((1.402075192528317, 2.194545889839955, 0.403829859842775), (362.602, 1078.965)),
}
"""Ground points (MesGCP-FromV1-Ground-Pts3D.xml) and pixels (MesIm-IMGP4168.JPG.xml) beside it."""


def test_published_orientations_see_published_ground_points_where_they_were_marked(
    tmp_path: Path,
) -> None:
    """Points that people marked in a photo lie within two pixels of their projections."""
    for name, inner in PUBLISHED.items():
        (tmp_path / name).write_text(file(inner), encoding="utf-8")
    network = fga.read(tmp_path / "Ori-PerspCentral-IMGP4168.JPG.xml")
    for name, (at, pixel) in MARKED.items():
        network.add_point(name, at)
        xy = [[pixel[0] + 0.5, -pixel[1] - 0.5]]
        network.add_image_points("IMGP4168.JPG", [name], np.array(xy), sigma=1.0)
    equations = compile_network(network)
    rows = next(b for b in equations.blocks if b.kind == "image").rows
    v = equations.residuals(equations.unknowns.start())[rows]
    assert v.size == 12 and np.abs(v).max() < 2.0


CALIBRATION = "Ori-X/Calib-PerspCentral-Foc-28000.xml"
POSE = "Ori-X/Ori-PerspCentral-1.tif.xml"


@pytest.mark.parametrize(
    ("path", "old", "new", "message"),
    [
        (CALIBRATION, "Stenope", "OrthoGraphik", r"28000\.xml:9: projection 'OrthoGraphik' cann"),
        (CALIBRATION, "<IsFraserMode>1", "<IsFraserMode>0", r"<IsFraserMode> '0' cannot be read"),
        (CALIBRATION, "<Degree>3", "<Degree>4", r"<Degree> 4 1 1 needs <K4>"),
        (CALIBRATION, "<Degree>3", "<Degree>2", r"<K3> is given twice or lies beyond <Degree> 2"),
        (CALIBRATION, "</Polynomial>", "<x_1_1>1</x_1_1></Polynomial>", r"<x_1_1> is given twice"),
        (CALIBRATION, "<F>2112", "<F>-2112", r"<F> must be greater than zero"),
        (CALIBRATION, ">0.0197<", ">x<", r"<K3>: 'x' is not a number"),
        (CALIBRATION, '<Name>"C', '<Name>"D', r"<Name> is 'Dalib-Persp.*; valid: 'Calib-Persp"),
        (CALIBRATION, '"MMVII_S', '"S', r"is no file of MMVII"),
        (CALIBRATION, '"0.0.0"', '"1.0"', r"version '1\.0' of MMVII cannot be read"),
        (POSE, "NameInternalCalib", "Other", r"1\.tif\.xml:6: the calibration '\.xml' is no file"),
        (POSE, '"1.tif"', '"2.tif"', r"1\.tif\.xml:7: is the pose of image '2\.tif'"),
        (POSE, "<AxeK>", "<AxeK>9", r"<RotMatrix> is no rotation matrix|is not a number"),
        ("Marks/MesIm-0.tif.xml", '"0.tif"', '"9.tif"', r"0\.tif\.xml:7: image '9\.tif' has no or"),
        ("Marks/MesIm-0.tif.xml", "<Sigma2>1 0 4", "<Sigma2>1 1 4", r"covariance xy 0"),
        ("Marks/MesGCP-X.xml", "4e-4 1e-4", "4e-4 9e-4", r"is no matrix of variances"),
        ("Marks/MesGCP-X.xml", "-4.0", "x", r"<Pt>: 'x' is not a number"),
    ],
)
def test_wrong_files_are_refused(
    path: str, old: str, new: str, message: str, tmp_path: Path
) -> None:
    ori = block(tmp_path)
    text = (tmp_path / path).read_text(encoding="utf-8")
    assert old in text
    (tmp_path / path).write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read(ori)


def test_every_image_without_an_orientation_is_named(tmp_path: Path) -> None:
    ori = block(tmp_path)
    for i in (1, 2):
        (ori / f"Ori-PerspCentral-{i}.tif.xml").unlink()
    with pytest.raises(InputError) as caught:
        read(ori)
    assert [p.where for p in caught.value.problems] == ["MesIm-1.tif.xml:7", "MesIm-2.tif.xml:7"]


def test_coefficients_beyond_a_lens_model_are_read_only_when_zero(tmp_path: Path) -> None:
    ori = block(tmp_path)
    path = tmp_path / CALIBRATION
    text = path.read_text(encoding="utf-8").replace("<Degree>3 1 1", "<Degree>4 2 2")
    more = {"Radial": "<K4>0</K4>", "Decentric": "<p3>0</p3><p4>0</p4>"}
    more["Polynomial"] = "<x_0_2>0</x_0_2>"
    for part, words in more.items():
        text = text.replace(f"</{part}>", f"{words}</{part}>")
    path.write_text(text, encoding="utf-8")
    assert read(ori).n_image_points == 27
    for name in ("K4", "p3", "x_0_2"):
        path.write_text(text.replace(f"<{name}>0", f"<{name}>1e-9"), encoding="utf-8")
        with pytest.raises(InputError, match=f"the coefficient <{name}> of projection Stenope can"):
            read(ori)


def test_a_calibration_without_an_affinity_has_the_common_lens(tmp_path: Path) -> None:
    """Other programs have it too; an affinity that is to be estimated needs its own."""
    ori = block(tmp_path)
    path = tmp_path / CALIBRATION
    assert read(ori).cameras["Foc-28000"].lens.kind == "normalised_fraser"
    text = path.read_text(encoding="utf-8").replace(str(B["b1"]), "0").replace(str(B["b2"]), "0")
    path.write_text(text, encoding="utf-8")
    camera = read(ori).cameras["Foc-28000"]
    assert camera.lens.kind == "normalised"
    values = dict(zip(camera.lens.names, camera.values, strict=True))
    assert values == {
        **{"c": F, "x0": PP[0] + 0.5, "y0": -PP[1] - 0.5},
        **{"k1": K["K1"], "k2": K["K2"], "k3": K["K3"], "p1": P["p1"], "p2": -P["p2"]},
    }
    assert read(ori, calibration=["b1"]).cameras["Foc-28000"].lens.kind == "normalised_fraser"


def test_an_affinity_of_a_fisheye_is_refused(tmp_path: Path) -> None:
    ori = block(tmp_path, "FE_EquiDist")
    path = tmp_path / CALIBRATION
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("<b1>0.0", "<b1>1e-9"), encoding="utf-8")
    with pytest.raises(InputError, match=r"<b1> of projection FE_EquiDist .* K1, K2, K3, K4, p1"):
        read(ori)


def test_folders_of_both_programs_and_of_other_sensors_are_refused(tmp_path: Path) -> None:
    ori = block(tmp_path)
    (ori / "Ori-PushBroom-a.xml").write_text(file("<A/>"), encoding="utf-8")
    with pytest.raises(InputError, match=r"Ori-PushBroom-a\.xml:1: is a sensor of another kind"):
        read(ori)
    (ori / "Ori-PushBroom-a.xml").unlink()
    for name, content in photo_files.micmac().items():
        (ori / name).write_bytes(content)
    with pytest.raises(InputError, match=r"has orientations of MicMac, .* and of MMVII"):
        read(ori)
    assert len(fga.read(ori / "Ori-PerspCentral-0.tif.xml").photos) == 3
    assert len(fga.read(ori / "Orientation-0.tif.xml").photos) == 3
