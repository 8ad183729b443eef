"""Small files of photogrammetric programs, all undamaged."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from tests.hostile.examples import Example
from tests.networks.pixel_block import pixel_block

DBAT = """<?xml version="1.0"?>
<document dbat_script_version="1.0">
<meta><name>small</name></meta>
<input base_dir="$HERE">
<ctrl_pts><file format="id,label,x,y,z,sx,sy,sz">control.txt</file>
<filter id="4">remove</filter></ctrl_pts>
<check_pts><file format="id,label,x,y,z,sx,sy,sz">control.txt</file>
<filter id="4">keep</filter></check_pts>
<images><file format="id,path">images.txt</file></images>
<prior_eo><file format="id,x,y,z,omega,phi,kappa" units="degrees">eo.txt</file></prior_eo>
<image_pts><file format="im,id,x,y" sxy="0.5">points.txt</file></image_pts>
<cameras><camera><id>1</id><name>cam</name><unit>mm</unit><sensor>auto,15</sensor>
<image>2000,1500</image><focal>15</focal><cc>15</cc><pp>10.03,7.48</pp><K>1e-4,0,0</K><P>0,0</P>
<model>3</model><skew>0</skew><aspect>1</aspect></camera></cameras>
</input>
<operations><operation min_rays="2">check_ray_count</operation>
<operation><set_initial_values><io><all>loaded</all></io><eo>loaded</eo></set_initial_values>
</operation>
<operation><set_bundle_estimate_params><io><all>true</all><skew>false</skew><P>false</P>
<K3>false</K3></io><eo><all>true</all></eo><op><all>default</all></op>
</set_bundle_estimate_params></operation>
<operation>bundle_adjustment</operation></operations>
</document>
"""
BUNDLER = """# Bundle file v0.3
3 2
500 -0.1 0.01
1 0 0
0 1 0
0 0 1
0 0 -5
500 0 0
1 0 0
0 1 0
0 0 1
-1 0 -5
0 0 0
0 0 0
0 0 0
0 0 0
0 0 0
0.5 0.25 0.1
1 2 3
2 0 7 50 25 1 8 -51 25
-0.5 -0.25 0
1 2 3
3 0 1 -49 -25 1 2 -148 -24 2 0 3 4
"""
IOR = """1 -999 -28.78 0.017 0.057 -1.1e-4 1.5e-7 13.488
0.0
5.8e-6 -8.6e-6
-7.0e-5 -3.1e-5
35.968 23.979 8688 5792
"""


def _files(folder: Path) -> dict[str, bytes]:
    return {f.name: f.read_bytes() for f in sorted(folder.iterdir()) if f.is_file()}


def _rows(network: fga.Network) -> list[tuple[int, str, float, float]]:
    """Return number of the photo, point, column and row of the image points."""
    points = list(network.points)
    photo, point, xy, _ = (c.tolist() for c in network.images.columns())
    return [(f, points[p], x, -y) for f, p, (x, y) in zip(photo, point, xy, strict=True)]


def dbat() -> dict[str, bytes]:
    """Return a script with its tables."""
    network = pixel_block()
    control = [
        f"{o.point[1:]}, {o.point}, {', '.join(map(repr, o.value))}, 0.01, 0.01, 0.02"
        for o in network.observations.values()
        if isinstance(o, fga.ControlPoint)
    ]
    control.append("4, P4, 1.0, 4.0, 0.1, 0, 0, 0")
    eo = [f"{i + 1}, 1, {i}, 30, 1, 2, {40 * i}" for i in range(4)]
    seen = [f"{f + 1}, {p[1:]}, {x!r}, {y!r}" for f, p, x, y in _rows(network)]
    tables = {"control": control, "eo": eo, "points": seen}
    tables["images"] = [f"{i + 1}, photos/{i}.jpg" for i in range(4)]
    out = {f"{n}.txt": ("# table\n" + "\n".join(r) + "\n").encode() for n, r in tables.items()}
    return {"script.xml": DBAT.encode(), **out}


def aicon() -> dict[str, bytes]:
    """Return the five files of a block."""
    obc = [f"{i} {100 * i} {50 * (i % 3)} {10 * i} 0.01 0.01 0.01 3 1 1 0" for i in range(6)]
    obc.append("9 1 2 3 0.1 0.1 0.1 2 0 1 0")
    eor = [f"{i} 1 {300 * i} 20 1500 0.1 {0.2 * i} 0.3 0 300 3" for i in range(4)]
    phc = [
        f"{f} {p} {0.5 * p - 1.5 + 0.1 * f} {0.3 * (p % 3)} 1e-4 1e-4 0 0 1 {int(p != 5)} 1"
        for f in range(4)
        for p in (*range(6), 9)
    ]
    texts = {"ior": IOR.splitlines(), "obc": obc, "eor": eor, "phc": phc}
    texts["scale"] = ['0 "bar" 0 3 304.1 0.01 1']
    return {f"block.{n}": ("\n".join(rows) + "\n").encode() for n, rows in texts.items()}


def metashape(folder: Path) -> dict[str, bytes]:
    """Return a file of cameras and markers."""
    fga.write_metashape(pixel_block(affine=True), folder / "cameras.xml")
    return _files(folder)


def ply(columns: dict[str, np.ndarray]) -> bytes:
    """Return a binary PLY file of columns in single precision, or of whole numbers."""
    kinds = {n: "uint" if c.dtype.kind in "iu" else "float" for n, c in columns.items()}
    count = len(next(iter(columns.values())))
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    head += [f"property {kind} {name}" for name, kind in kinds.items()] + ["end_header", ""]
    table = np.zeros(count, [(n, "<u4" if k == "uint" else "<f4") for n, k in kinds.items()])
    for name, values in columns.items():
        table[name] = values
    return "\n".join(head).encode() + table.tobytes()


def psz(folder: Path) -> dict[str, bytes]:
    """Return an archive of Metashape in which tie points are those without control."""
    network = pixel_block(observed=False)
    files = metashape(folder)
    text = files["cameras.xml"].decode()
    text = text.replace('<chunk label="pixel block" enabled="true">', '<chunks><chunk id="0">')
    text = text.replace("</chunk>", "</chunk></chunks>")
    ties = [n for n in network.points if n in ("P1", "P3", "P5", "P7", "P8", "P10")]
    cloud = ['<points path="points0.ply"/>']
    xyz = np.array([network.points[n].coordinates for n in ties])
    number = np.arange(len(ties))
    members = {"points0.ply": ply(dict(zip("xyz", xyz.T, strict=True)) | {"id": number})}
    rows = _rows(network)
    for photo in range(4):
        mine = [r for r in rows if r[0] == photo and r[1] in ties]
        xy = np.array([r[2:] for r in mine])
        ident = np.array([ties.index(r[1]) for r in mine])
        columns = {"x": xy[:, 0], "y": xy[:, 1], "size": xy[:, 0] * 0 + 2, "id": ident}
        members[f"projections{photo}.ply"] = ply(columns)
        cloud.append(f'<projections camera_id="{photo}" path="projections{photo}.ply"/>')
    inside = "<point_cloud>" + "".join(cloud) + "</point_cloud></frame>"
    members["doc.xml"] = text.replace("</frame>", inside).encode()
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as written:
        for name, content in members.items():
            written.writestr(zipfile.ZipInfo(name), content)
    return {"project.psz": out.getvalue()}


def opf(folder: Path) -> dict[str, bytes]:
    """Return a project of OPF."""
    fga.write_opf(pixel_block(), folder / "block.opf")
    return _files(folder)


def opensfm() -> dict[str, bytes]:
    """Return a reconstruction with tracks, reference and ground control."""
    camera = {"projection_type": "perspective", "width": 2000, "height": 1500, "focal": 0.75}
    shots = {
        f"{i}.jpg": {
            "rotation": [3.0, 0.1 * i, 0.2],
            "translation": [i - 1.5, 1.0, 30.0],
            "camera": "cam",
            "gps_position": [1.0, 2.0, 30.0],
            "gps_dop": 5.0,
        }
        for i in range(3)
    }
    points = {str(j): {"coordinates": [j - 2.0, j % 3, 0.1 * j]} for j in range(6)}
    document = [
        {"cameras": {"cam": camera | {"k1": 0.1, "k2": 0.0}}, "shots": shots, "points": points}
    ]
    tracks = ["OPENSFM_TRACKS_VERSION_v2"]
    tracks += [
        f"{i}.jpg\t{j}\t{j}\t{0.05 * j - 0.1}\t{0.02 * i}\t0.001\t1\t2\t3\t-1\t-1"
        for i in range(3)
        for j in range(6)
    ]
    ground = ["WGS84"]
    ground += [
        f"13.40{j} 52.50{j} 4{j} {100 + j} {200 + i} {i}.jpg G{j}" for i in (0, 1) for j in (1, 2)
    ]
    return {
        "reconstruction.json": json.dumps(document, indent=1).encode(),
        "reference_lla.json": b'{"latitude": 52.5, "longitude": 13.4, "altitude": 40.0}',
        "tracks.csv": ("\n".join(tracks) + "\n").encode(),
        "gcp_list.txt": ("\n".join(ground) + "\n").encode(),
    }


def openmvg(
    intrinsics: tuple[str, dict[str, object]] = ("pinhole_radial_k3", {"disto_k3": [0.1, 0, 0]}),
    *,
    poses: list[tuple[list[list[float]], list[float]]] | None = None,
    seen: dict[int, dict[int, list[float]]] | None = None,
    points: list[list[float]] | None = None,
    control: int = 1,
) -> dict[str, bytes]:
    """Return sfm_data.json as cereal writes it.

    Args:
        intrinsics: name of the type, and the members of its distortion.
        poses: rotation and centre of each view.
        seen: image coordinates of points, by number of view and point.
        points: coordinates; the first ``control`` of them are control points.
        control: number of control points.
    """
    if poses is None:
        down = [[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]]
        poses = [(down, [3.0 * i - 3, 0.5 * i, 30.0]) for i in range(3)]
    points = points or [[j - 2.0, float(j % 3), 0.1 * j] for j in range(6)]
    if seen is None:
        seen = {
            i: {
                j: [1000 + 1500 * (x - c[0]) / (c[2] - z), 750 - 1500 * (y - c[1]) / (c[2] - z)]
                for j, (x, y, z) in enumerate(points)
            }
            for i, (_, c) in enumerate(poses)
        }
    first = 0x80000000
    views = []
    for i in range(len(poses) + 1):  # the last one has no pose
        data = {
            "local_path": "", "filename": f"{i}.jpg", "width": 2000, "height": 1500,
            "id_view": i, "id_intrinsic": 0, "id_pose": i,
        }  # fmt: skip
        kind: dict[str, object] = {"polymorphic_id": 0x40000000}
        if i < 2:  # priors: the name of the type stands at its first use
            kind = {"polymorphic_id": first + 1 if i == 0 else 1}
            kind |= {"polymorphic_name": "view_priors"} if i == 0 else {}
            data |= {"use_pose_center_prior": True, "center_weight": [20.0, 20.0, 10.0],
                     "center": poses[i][1]}  # fmt: skip
        views.append(
            {"key": i, "value": kind | {"ptr_wrapper": {"id": first + i + 1, "data": data}}}
        )
    camera = {"width": 2000, "height": 1500, "focal_length": 1500.0,
              "principal_point": [1000.0, 750.0]}  # fmt: skip
    lens = {
        "key": 0,
        "value": {
            "polymorphic_id": first + 2,
            "polymorphic_name": intrinsics[0],
            "ptr_wrapper": {"id": first + 20, "data": camera | intrinsics[1]},
        },
    }
    marks = [
        {
            "key": j,
            "value": {
                "X": x,
                "observations": [
                    {"key": i, "value": {"id_feat": j, "x": at[j]}}
                    for i, at in seen.items()
                    if j in at
                ],
            },
        }
        for j, x in enumerate(points)
    ]
    document = {
        "sfm_data_version": "0.3",
        "root_path": "/photos",
        "views": views,
        "intrinsics": [lens],
        "extrinsics": [
            {"key": i, "value": {"rotation": r, "center": c}} for i, (r, c) in enumerate(poses)
        ],
        "structure": marks[control:],
        "control_points": marks[:control],
    }
    return {"sfm_data.json": json.dumps(document, indent=1).encode()}


def opencv(suffix: str, folder: Path) -> dict[str, bytes]:
    """Return a calibration with two views of a board of six corners."""
    network = fga.Network("lens")
    from factorgraph_adj.models.lens import NormalisedLens

    network.add_camera(
        *("camera", NormalisedLens(), {"c": 500.0, "x0": 320.0, "y0": -240.0, "k1": -0.1}),
        unit="px",
        format=(640, 480),
        origin="upper left",
    )
    fga.write_opencv(network, folder / f"calibration{suffix}")
    ((name, content),) = _files(folder).items()
    views = {
        "extrinsic_parameters": (2, 6, "d", "0.1 0.2 0.3 0 0 1 0.1 0.1 0 0 0 1"),
        "image_points": (2, 6, "2f", " ".join(f"{100 + 7 * i}. {50 + 3 * i}." for i in range(12))),
        "grid_points": (6, 1, "3f", " ".join(f"0.{i}3 0.0{i} 0" for i in range(6))),
    }
    text = content.decode()
    for key, (rows, cols, kind, data) in views.items():
        if suffix == ".xml":
            inner = f"<rows>{rows}</rows><cols>{cols}</cols><dt>{kind}</dt><data>{data}</data>"
            more = f'<{key} type_id="opencv-matrix">{inner}</{key}>\n</opencv_storage>'
            text = text.replace("</opencv_storage>", more)
        else:
            numbers = data.replace(" ", ", ")
            text += f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: {kind}\n"
            text += f"   data: [ {numbers} ]\n"
    return {name: text.encode()}


MICMAC = """<?xml version="1.0" ?>
<ExportAPERO><CalibrationInternConique><KnownConv>eConvApero_DistM2C</KnownConv>
<PP>1003.0 748.5</PP><F>1500.0</F><SzIm>2000 1500</SzIm>
<CalibDistortion><ModRad><CDist>990.5 751.25</CDist><CoeffDist>-2e-9</CoeffDist></ModRad>
</CalibDistortion></CalibrationInternConique></ExportAPERO>
"""
ORIENTATION = """<?xml version="1.0" ?>
<ExportAPERO><OrientationConique><TypeProj>eProjStenope</TypeProj>
<FileInterne>AutoCal.xml</FileInterne>
<Externe><Centre>{0} 1.5 30.25</Centre><ParamRotation><CodageMatr>
<L1>1 0 0</L1><L2>0 -1 0</L2><L3>0 0 -1</L3></CodageMatr></ParamRotation></Externe>
<ConvOri><KnownConv>eConvApero_DistM2C</KnownConv></ConvOri></OrientationConique></ExportAPERO>
"""


def micmac() -> dict[str, bytes]:
    """Return orientations, a calibration, control and its measurements."""
    out = {"AutoCal.xml": MICMAC}
    control, images = [], []
    for i in range(3):
        out[f"Orientation-{i}.tif.xml"] = ORIENTATION.format(3.5 * i)
        seen = "\n".join(
            f"<OneMesureAF1I><NamePt>G{j}</NamePt><PtIm>{900 + 40 * j - 170 * i} {700 + 30 * j}"
            "</PtIm></OneMesureAF1I>"
            for j in range(4)
        )
        images.append(
            f"<MesureAppuiFlottant1Im><NameIm>{i}.tif</NameIm>{seen}</MesureAppuiFlottant1Im>"
        )
    for j in range(3):
        inner = f"<Pt>{j} {2 * j} 0.5</Pt><NamePt>G{j}</NamePt><Incertitude>0.1 0.1 0.2"
        control.append(f"<OneAppuisDAF>{inner}</Incertitude></OneAppuisDAF>")
    lines = "\n".join
    out["control.xml"] = f"<DicoAppuisFlottant>{lines(control)}</DicoAppuisFlottant>"
    whole = "SetOfMesureAppuisFlottants"
    out["measures.xml"] = f"<{whole}>{lines(images)}</{whole}>"
    return {name: text.encode() for name, text in out.items()}


def mmvii() -> dict[str, bytes]:
    """Return orientations of MMVII, a calibration, control and its measurements."""

    def whole(inner: str) -> str:
        kind = '<Type>"MMVII_Serialization"</Type>\n<Version>"0.0.0"</Version>'
        return f'<?xml version="1.0" ?>\n<Root>\n{kind}\n<Data>\n{inner}\n</Data>\n</Root>\n'

    out = {"Calib-PerspCentral-F28.xml": whole(MMVII_CALIBRATION)}
    for i in range(3):
        name = f"Ori-PerspCentral-{i}.tif.xml"
        out[name] = whole(MMVII_POSE.format(i, 3.5 * i))
    seen = "\n".join(
        f'<el><Name>"G{j}"</Name><Pt>{900 + 40 * j} {700 + 30 * j}</Pt><Sigma2>1 0 1</Sigma2></el>'
        for j in range(4)
    )
    inner = f'<NameIm>"0.tif"</NameIm>\n<Measures>\n{seen}\n</Measures>'
    out["measures.xml"] = whole(f"<SetMesIm>\n{inner}\n</SetMesIm>")
    points = "\n".join(
        f'<el><Name>"G{j}"</Name>\n<Pt>{j} {2 * j} 0.5</Pt>\n'
        "<__Opt__Sigma2>0.01 0 0 0.01 0.001 0.04</__Opt__Sigma2></el>"
        for j in range(3)
    )
    out["control.xml"] = whole(f"<SetGCP>\n<Measures>\n{points}\n</Measures>\n</SetGCP>")
    return {name: text.encode() for name, text in out.items()}


MMVII_CALIBRATION = """<InternalCalibration>
<Name>"Calib-PerspCentral-F28"</Name>
<PixelFrame><NbPix>2000 1500</NbPix></PixelFrame>
<Projection>"Stenope"</Projection>
<Auxiliary><Degree>2 1 1</Degree><IsFraserMode>1</IsFraserMode></Auxiliary>
<PerfectProj><F>1500.5</F><PP>1003.0 748.5</PP></PerfectProj>
<Distorsion>
<Radial><K1>-0.08</K1><K2>0.1</K2></Radial>
<Decentric><p1>3e-4</p1><p2>-2e-4</p2></Decentric>
<Polynomial><b1>1e-5</b1><b2>2e-5</b2></Polynomial>
</Distorsion>
</InternalCalibration>"""
MMVII_POSE = """<CameraPose>
<NameImage>"{0}.tif"</NameImage>
<NameInternalCalib>"Calib-PerspCentral-F28"</NameInternalCalib>
<Center>{1} 1.5 30.25</Center>
<RotMatrix>
<AxeI>1 0 0</AxeI>
<AxeJ>0 -1 0</AxeJ>
<AxeK>0 0 -1</AxeK>
</RotMatrix>
</CameraPose>"""


COLMAP = {
    "cameras.txt": """# a comment
1 OPENCV 100 80 100 100 50 40 0.1 0.01 0.001 0.002
2 SIMPLE_PINHOLE 100 80 100 50 40
""",
    "images.txt": """# two lines each
7 1 0 0 0 0 0 0 1 first image.jpg
50 40 3 60.5 40 4 10 10 -1
9 1 0 0 0 0.5 0 0 2 b.jpg
60 40 3
2 0 1 0 0 0 0 10 1 c.jpg
50 40 3 40 40.5 4
""",
    "points3D.txt": """3 0 0 5 255 0 0 0.1 7 0 9 0 2 0
4 0.5 0 5 0 0 0 0.2 7 1 2 1
""",
    "rigs.txt": "1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 0.5 0 0\n",
    "frames.txt": "1 1 1 0 0 0 0 0 0 2 CAMERA 1 7 CAMERA 2 9\n2 1 0 1 0 0 0 0 10 1 CAMERA 1 2\n",
}


def colmap() -> dict[str, bytes]:
    """Return a model with a rig of two cameras in text."""
    return {name: text.encode() for name, text in COLMAP.items()}


def colmap_binary(folder: Path) -> dict[str, bytes]:
    """Return the same model in binary files."""
    from factorgraph_adj.io.photogrammetry.colmap import read_sparse_model
    from factorgraph_adj.io.photogrammetry.colmap_binary_files import binary_files

    for name, text in COLMAP.items():
        (folder / name).write_text(text, encoding="utf-8")
    return dict(binary_files(read_sparse_model(folder)))


COLMAP_UNREAD = (r"\|#", r"\|word\| qz7x\|.*\.jpg$")
"""Comments; an image name may have blanks."""
OPENCV_UNREAD = (r"%YAML", r"type_id=")
EXAMPLE_FILES = {
    "colmap": Example("colmap", lambda _: colmap(), unread=COLMAP_UNREAD),
    "colmap binary": Example("colmap", colmap_binary, unread=COLMAP_UNREAD),
    "metashape": Example("metashape", psz, "project.psz", open_names=True),
    "metashape-xml": Example(
        "metashape-xml",
        metashape,
        "cameras.xml",
        unread=(
            r"<document version=|next_id=|next_group_id=",
            r"<property name=\"fixed\"",  # a sensor that is fixed has no optimised parameters
            r"<resolution .*",  # of a calibration: that of the sensor counts
            r"<scalebar id=|<frame id=|LOCAL_CS",
        ),
        open_names=True,
    ),
    "opf": Example(
        "opf",
        opf,
        "block.opf",
        unread=(
            r"\"(id|description|version)\": \"",  # of items: their type and resources count
            r"input-cameras\.json\|value\|",  # first calibrations, positions before the projection
            r"input-control-points\.json\|value\|-?\d",  # coordinates before the projection
            r"\"generator\"|\"name\": \"factorgraph_adj\"|\"type\": \"\w+\"$",  # sources of an item
            r"calibrated-cameras\.json\|value\|\d+\|\s*\"sensor_id\"",
            r"scene-reference-frame\.json\|value",  # of coordinates before the projection
            r"calibrated-control-points\.json\|value\|",  # approximate coordinates
        ),
        open_names=True,
    ),
    "opensfm": Example(
        "opensfm",
        lambda _: opensfm(),
        "reconstruction.json",
        unread=(
            r"reconstruction\.json\|value\|.*\|\s*(-?[\d.]+,?|\"gps_dop.*)$",  # positions by GPS
            r"tracks\.csv",  # photos and points without reconstruction, features, colours
            r"gcp_list\.txt\|(value\|\d\.jpg|word)",  # photos without one; extra columns
        ),
        left_out=(r"tracks\.csv\|value", r"gcp_list\.txt\|value\|\d\.jpg"),  # of other photos
        open_names=True,
    ),
    "openmvg": Example(
        "openmvg",
        lambda _: openmvg(),
        "sfm_data.json",
        {"positions": "observe"},
        unread=(
            r"root_path|\"(id_feat|id_view|width|height|polymorphic_id)\"",
            r"\"(local_path|filename|id_intrinsic)\"",  # of views without a pose
        ),
        open_names=True,
    ),
    "opencv": Example(
        "opencv",
        lambda folder: opencv(".yml", folder),
        "calibration.yml",
        unread=OPENCV_UNREAD,
        open_names=True,
    ),
    "opencv xml": Example(
        "opencv",
        lambda folder: opencv(".xml", folder),
        "calibration.xml",
        unread=OPENCV_UNREAD,
        open_names=True,
    ),
    "micmac": Example(
        "micmac",
        lambda _: micmac(),
        "Orientation-0.tif.xml",
        beside={"control": "control.xml", "measures": "measures.xml"},
        open_names=True,
    ),
    "micmac of mmvii": Example(
        "micmac",
        lambda _: mmvii(),
        "Ori-PerspCentral-0.tif.xml",
        beside={"control": "control.xml", "measures": "measures.xml"},
        open_names=True,
    ),
    "bundler": Example("bundler", {"b.out": BUNDLER}, "b.out", unread=(r"\|# Bundle",)),
    "dbat": Example(
        "dbat",
        lambda _: dbat(),
        "script.xml",
        unread=(
            r"\|#",
            r"<meta>|<document |min_rays=|images\.txt\|",
            r"\|value\|1\|<cameras><camera><id>",  # the only camera
        ),
    ),
    "aicon": Example(
        "aicon",
        lambda _: aicon(),
        "block.obc",
        unread=(
            r"block\.ior\|value\|-999\|",  # number of the set of parameters
            r"block\.obc\|value\|\d\|",  # points that no photo sees
            r"block\.phc\|value\|\d\|",  # points that .obc does not have; method
        ),
        left_out=(r"block\.(obc|phc)\|value\|\d\|",),  # image points of points that .obc lacks
    ),
}
