"""Reader of COLMAP: a sparse model with its rigs, control and prior positions as a network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from ...entities import Point
from ...errors import InputError, LeftOut, Problem, known
from ...models.similarity import Similarity
from ...network.network import Network
from ...observations.positions import PhotoPosition
from ...rotation import TURN_ABOUT_X, log_rotation
from ...start.image_axes import problems_of_marks
from ...types import Array
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..source import Problems
from .colmap_binary_files import read_binary_model
from .colmap_cameras import CAMERA_MODEL_BY_NAME
from .colmap_model import (
    NO_POINT,
    CameraRecord,
    FrameRecord,
    ImageRecord,
    Pose,
    RigRecord,
    SparseModel,
    check_model,
)
from .colmap_reference import (
    IDENTITY_SIMILARITY,
    ControlMark,
    ModelTables,
    UnregisteredChoice,
    keypoint_scales,
    mark_rays,
    ray_intersection,
    similarity_of_points,
)
from .colmap_text_files import read_text_model
from .ground_control import BlockReference, read_block_reference, similarity_or_problem

CalibrationChoice = Literal["colmap", "all", "held"]
"""Which parameters of the cameras are unknown."""
MountChoice = Literal["free", "held"]
"""Whether the mounts of the cameras of rigs are unknown."""
RepeatedChoice = Literal["refuse", "leave out"]
"""What to do with several measurements of a point in one image."""
MOUNT_ANGLES, MOUNT_ARM = ("rx", "ry", "rz"), ("x", "y", "z")
MODEL_TABLES = ("cameras", "images", "points3D")
MODEL_SUFFIXES = (".bin", ".txt")
MODEL_FILES = (*MODEL_TABLES, "rigs", "frames")
"""Files of a model by which its folder is known."""


def is_colmap(path: Path) -> bool:
    """Return whether a folder has the files of a sparse model, or a file is one of these."""
    if path.is_file():
        return path.stem in MODEL_FILES and _has_model(path.parent, path.suffix)
    return any(_has_model(path, suffix) for suffix in MODEL_SUFFIXES)


def _has_model(folder: Path, suffix: str) -> bool:
    """Return whether a folder has all files of a model with a suffix."""
    there = (folder / f"{name}{suffix}" for name in MODEL_TABLES)
    return suffix in MODEL_SUFFIXES and all(path.is_file() for path in there)


def read_sparse_model(folder: Path) -> SparseModel:
    """Read the files of a folder, binary ones where there are both.

    Raises:
        InputError: files are missing, are not of this format, or contradict one another.
    """
    for suffix, reader in ((".bin", read_binary_model), (".txt", read_text_model)):
        there = [name for name in MODEL_TABLES if (folder / f"{name}{suffix}").is_file()]
        if len(there) == len(MODEL_TABLES):
            model = reader(folder)
            check_model(model)
            return model
    inside = sorted(p.parent for p in folder.glob("*/images.*")) if folder.is_dir() else []
    inside += sorted(p.parent for p in folder.glob("*/*/images.*")) if folder.is_dir() else []
    if folder.is_file():
        what = f"is no sparse model: give the folder that has {', '.join(MODEL_TABLES)}"
        raise InputError(Problem(what, str(folder)))
    what = f"has no sparse model: {', '.join(f'{n}.bin or {n}.txt' for n in MODEL_TABLES)}"
    models = list(dict.fromkeys(str(p) for p in inside if is_colmap(p)))
    if models:
        what += f"; there are models in {known(models)}"
    raise InputError(Problem(what, str(folder)))


def read_colmap(
    path: str | Path,
    *,
    sigma: float = 1.0,
    sigma_by_scale: str | Path | None = None,
    control: str | Path | None = None,
    marks: str | Path | None = None,
    priors: str | Path | None = None,
    calibration: CalibrationChoice = "colmap",
    mounts: MountChoice = "free",
    repeated: RepeatedChoice = "refuse",
    unregistered: UnregisteredChoice = "refuse",
    gcp: str | Path | None = None,
    positions: str | Path | None = None,
    sigma_gcp: tuple[float, float] = (0.01, 0.1),
    sigma_gcp_px: float = 1.0,
    sigma_positions: tuple[float, float] | None = None,
    positions_system: str | None = None,
) -> Network:
    """Read a sparse model of COLMAP, text or binary, as a network.

    Cameras and points have their numbers as names, photos the names of the images. Image
    coordinates are pixels from the upper left corner. Rigs of several cameras become photos on
    carriers (see `Network.add_photo`), with the mounts ``rig R camera C``; the carrier is the image
    of the reference camera, or a photo ``frame F`` without image points where there is none.

    Without control points and priors the network is free. With them, the model is carried over to
    their system by a similarity, for start values.

    Measurements that belong to no 3-D point, the colours and errors of points are of no use to an
    adjustment and are not read. Images without measurements of 3-D points, whose pose nothing
    determines, are left out; the name of the network says how many.

    Args:
        path: the folder with cameras, images and points3D (and rigs, frames), ``.bin`` or
            ``.txt``; or one of these files, which stands for its folder.
        sigma: standard deviation of image coordinates, pixels; COLMAP states none.
        sigma_by_scale: database of COLMAP with the keypoints: σ of a measurement is ``sigma`` times
            the scale of its keypoint, divided by the median scale of all measurements.
        control: table of control and check points, with the columns of a project's ``points.csv``,
            metres. A name that is the number of a 3-D point is that point; others need marks.
        marks: table of the image coordinates of control points: photo, point, x, y (pixels from
            the upper left corner, y down), and sigma where it is not that of the others.
        priors: table of positions of photos: photo, x, y, z (metres), and σ with its unit
            (``sigma_m``; ``sigma_x_m``, ``sigma_y_m``, ``sigma_z_m``), perhaps a lever arm
            (``arm_x_m`` …, see `PhotoPosition`).
        calibration: unknown parameters of the cameras: those that COLMAP estimates (focal lengths
            and distortion), all with the principal point, or none.
        mounts: whether mounts of rigs are unknown; COLMAP's values are then approximate.
        repeated: what to do with a point that is measured several times in one image, of which one
            measurement at most is right: refuse the file, or leave all of them out.
        unregistered: what to do with rows of ``marks`` and ``priors`` whose image is not in the
            model.
        gcp: list of ground control of ODM or OpenSfM in a reference system, in place of ``control``
            and ``marks``; the network gets a topocentric frame in the middle of the lists.
        positions: list of positions of photos, in place of ``priors``: geo.txt of ODM, or a table
            of Metashape, Pix4D or ``exiftool -csv``, see `io.photogrammetry.coordinate_lists`.
            Angles in it are not read; images that the model does not have are left out.
        sigma_gcp: standard deviations of ``gcp``, horizontal and vertical, metres.
        sigma_gcp_px: standard deviation of its image coordinates, pixels.
        sigma_positions: those of ``positions`` for which the file states no σ, horizontal and
            vertical, metres.
        positions_system: reference system of a table of positions that states none.

    Raises:
        InputError: files are missing or damaged, contradict one another, have camera models
            without a lens model; tables have problems; all with file and line (or byte).
    """
    _check_choices(
        calibration=(calibration, CalibrationChoice),
        mounts=(mounts, MountChoice),
        repeated=(repeated, RepeatedChoice),
        unregistered=(unregistered, UnregisteredChoice),
    )
    if not (isinstance(sigma, int | float) and 0 < sigma < np.inf):
        raise InputError(f"sigma must be greater than zero, pixels, not {sigma!r}")
    by_list = gcp is not None or positions is not None
    if by_list and any(table is not None for table in (control, marks, priors)):
        what = "lists (gcp, positions) and tables (control, marks, priors) exclude each other"
        raise InputError(Problem(what, "colmap"))
    folder = Path(path)
    if folder.is_file() and is_colmap(folder):
        folder = folder.parent
    model = read_sparse_model(folder)
    tables = ModelTables.read(control, marks, priors, model, unregistered)
    by_scale = None
    if sigma_by_scale is not None:
        wanted = {i.name: len(i.points) for i in model.images if (i.points != NO_POINT).any()}
        by_scale = keypoint_scales(Path(sigma_by_scale), wanted)
    problems, reference = Problems(), None
    if by_list:
        reference = read_block_reference(
            gcp,
            positions,
            [i.name for i in model.images],
            problems,
            sigma_gcp=sigma_gcp,
            sigma_gcp_px=sigma_gcp_px,
            sigma_positions=sigma_positions,
            positions_system=positions_system,
        )
        tables = ModelTables(reference.control, reference.marks, reference.priors)
    made = _Assembly(model, tables, float(sigma), by_scale, calibration, mounts, repeated)
    network = made.network(folder.name, reference)
    if reference is not None:
        network.add(*reference.observations)
    problems.finish(network)
    return network


def _check_choices(**given: tuple[str, object]) -> None:
    """Refuse options that are none of their choices."""
    problems = []
    for name, (value, choices) in given.items():
        if value not in (valid := get_args(choices)):
            problems.append(
                Problem(f"unknown {name} {value!r}; valid: {', '.join(valid)}", "colmap")
            )
    if problems:
        raise InputError(problems)


@dataclass(frozen=True)
class _Assembly:
    """A network in the making."""

    model: SparseModel
    tables: ModelTables
    sigma: float
    by_scale: Mapping[str, Array] | None
    calibration: CalibrationChoice
    mounts: MountChoice
    repeated: RepeatedChoice

    def network(self, name: str, reference: BlockReference | None = None) -> Network:
        """Return the network."""
        model, tables = self.model, self.tables
        free = not tables.control and not tables.priors
        moved = IDENTITY_SIMILARITY if free else self._similarity(reference)
        frame = None if reference is None else reference.frame
        network = Network(datum="free" if free else "given", frame=frame)
        number_of = {p.number: i for i, p in enumerate(model.points)}
        xyz = np.array([p.xyz for p in model.points]).reshape(-1, 3)
        network.add_points([str(p.number) for p in model.points], moved.of(xyz))
        for point in tables.control.values():
            self._control(network, point)
        for camera in model.cameras:
            self._camera(network, camera)
        left = self._photos(network, moved)
        out = self._measurements(network, number_of)
        for mark in tables.marks:
            self._mark(network, mark)
        network.add(
            *(
                PhotoPosition(p.photo, p.xyz, sigma=p.sigma, lever_arm=p.arm, source=p.where)
                for p in tables.priors
            )
        )
        if problems := problems_of_marks(network):
            raise InputError(problems)
        network.left_out += tables.left_out
        if apart := sum(int((i.points == NO_POINT).sum()) for i in model.images):
            network.left_out.append(
                LeftOut("measurements", "they belong to no 3-D point", (), apart)
            )
        network.name = name
        if left:
            network.left_out.append(
                LeftOut("images", "they see no 3-D point", tuple(left), len(left))
            )
            network.name += f" without {len(left)} images that see no 3-D point"
        if out:
            why = "their points are measured several times in one image"
            network.left_out.append(LeftOut("measurements", why, (), out))
            network.name += f" without {out} measurements of points measured twice in an image"
        return network

    # -- points -------------------------------------------------------------------------------

    def _control(self, network: Network, point: Point) -> None:
        """Add a control point, or state the coordinates of the 3-D point of its number."""
        if point.name not in network.points:
            network.points[point.name] = point
            network.point_number[point.name] = len(network.point_number)
            return
        given, found = np.array(point.coordinates), network.points[point.name].coordinates
        at = np.where(np.isfinite(given), given, found)
        network.points[point.name] = replace(point, coordinates=tuple(at.tolist()))

    def _similarity(self, reference: BlockReference | None) -> Similarity:
        """Return the similarity from the model to the system of the tables.

        Raises:
            InputError: the tables do not determine it, or exchange x and y.
        """
        images = {i.name: i for i in self.model.images}
        x, to = [], []
        for prior in self.tables.priors:
            pose = images[prior.photo].pose
            x.append(pose.centre)
            to.append(prior.xyz)
        places = {str(p.number): np.array(p.xyz) for p in self.model.points}
        by_point: dict[str, list[ControlMark]] = {}
        for mark in self.tables.marks:
            by_point.setdefault(mark.point, []).append(mark)
        for name, point in self.tables.control.items():
            if not np.isfinite(point.coordinates).all():
                continue
            at = places.get(name)
            if at is None:
                measured = [(images[m.photo], m) for m in by_point.get(name, ())]
                at = ray_intersection(*mark_rays(self.model, measured))
            if at is not None:
                x.append(at)
                to.append(point.coordinates)
        block, there = np.array(x).reshape(-1, 3), np.array(to).reshape(-1, 3)
        if reference is not None:
            reference.refuse_exchanged_order(block, there)
            if similarity_of_points(block, there) is None:
                reference.refuse_places_apart(block, there)
        return similarity_or_problem(block, there, "colmap")

    # -- cameras and photos -------------------------------------------------------------------

    def _camera(self, network: Network, camera: CameraRecord) -> None:
        model = CAMERA_MODEL_BY_NAME[camera.model]
        assert model.lens is not None
        unknown = {"held": (), "colmap": model.unknowns}.get(self.calibration)
        if unknown is None:
            unknown = (*model.unknowns, *(("x0", "y0") if model.unknowns else ()))
        network.add_camera(
            str(camera.number),
            model.lens,
            model.to_lens(camera.parameters),
            free=unknown,
            unit="px",
            format=camera.size,
            origin="upper left",
            y_down_in_files=True,
        )

    def _photos(self, network: Network, moved: Similarity) -> list[str]:
        """Add photos, on carriers where rigs have several cameras; return the others."""
        frames = self._frames()
        marked = {m.photo for m in self.tables.marks}
        present = {
            i.number for i in self.model.images if (i.points != NO_POINT).any() or i.name in marked
        }
        images = {i.number: i for i in self.model.images}
        names = {i.name for i in self.model.images}
        done: set[int] = set()
        for rig, frame in frames:
            own = {s[1]: images[n] for s, n in frame.data if s[0] == "CAMERA" and n in present}
            if not own:
                continue
            assert rig.reference is not None
            kind, reference = rig.reference
            first = own.get(reference) if kind == "CAMERA" else None
            if first is not None:
                carrier = first.name
                self._photo(network, moved, carrier, first.camera, first.pose)
                done.add(first.number)
            elif len(own) == 1:
                continue  # one camera alone: no carrier is needed
            else:
                carrier = f"frame {frame.number}"
                while carrier in names:
                    carrier += "'"
                stand_in = reference if kind == "CAMERA" else next(iter(own))
                self._photo(network, moved, carrier, stand_in, frame.pose)
            for camera, image in own.items():
                if image.number in done:
                    continue
                mount = self._mount(network, moved, rig, frame, camera, image)
                self._photo(network, moved, image.name, camera, image.pose, carrier, mount)
                done.add(image.number)
        for image in self.model.images:
            if image.number in present - done:
                self._photo(network, moved, image.name, image.camera, image.pose)
        return [i.name for i in self.model.images if i.number not in present]

    def _frames(self) -> list[tuple[RigRecord, FrameRecord]]:
        """Return the frames of rigs of two sensors or more."""
        rigs = {r.number: r for r in self.model.rigs if len(r.others)}
        return [(rigs[f.rig], f) for f in self.model.frames if f.rig in rigs]

    def _photo(
        self,
        network: Network,
        moved: Similarity,
        name: str,
        camera: int,
        pose: Pose,
        carrier: str | None = None,
        mount: str | None = None,
    ) -> None:
        network.add_photo(
            name,
            str(camera),
            position=moved.of(pose.centre[None])[0].tolist(),
            rotation=moved.rotation @ pose.rotation.T,
            carrier=carrier,
            mount=mount,
        )

    def _mount(
        self,
        network: Network,
        moved: Similarity,
        rig: RigRecord,
        frame: FrameRecord,
        camera: int,
        image: ImageRecord,
    ) -> str:
        """Return the mount of a camera of a rig; state it if it is new.

        The mounts of a rig whose reference is no camera share what nothing observes: one is held.
        """
        name = f"rig {rig.number} camera {camera}"
        if name in network.mounts:
            return name
        stated = dict(rig.others).get(("CAMERA", camera))
        if stated is not None:
            turn, centre = stated.rotation.T, stated.centre
        else:
            turn = frame.pose.rotation @ image.pose.rotation.T
            centre = frame.pose.rotation @ (image.pose.centre - frame.pose.centre)
        b = log_rotation((TURN_ABOUT_X @ turn @ TURN_ABOUT_X)[None])[0]
        arm = moved.scale * TURN_ABOUT_X @ centre
        values = dict(zip((*MOUNT_ANGLES, *MOUNT_ARM), [*b.tolist(), *arm.tolist()], strict=True))
        assert rig.reference is not None
        of_rig = [m for m in network.mounts if m.startswith(f"rig {rig.number} camera ")]
        held = self.mounts == "held" or (rig.reference[0] != "CAMERA" and not of_rig)
        network.set_mount(name, free=() if held else (*MOUNT_ANGLES, *MOUNT_ARM), values=values)
        return name

    # -- measurements -------------------------------------------------------------------------

    def _measurements(self, network: Network, number_of: Mapping[int, int]) -> int:
        """Add the image points; return how many measurements are left out.

        Raises:
            InputError: a point is measured several times in one image, and that is refused.
        """
        problems: list[Problem] = []
        out = 0
        unit = 1.0
        if self.by_scale is not None:
            every = [
                self.by_scale[i.name][i.points != NO_POINT]
                for i in self.model.images
                if i.name in self.by_scale
            ]
            unit = float(np.median(np.concatenate(every))) if every else 1.0
        for image in self.model.images:
            used = np.flatnonzero(image.points != NO_POINT)
            if not len(used):
                continue
            numbers, first, count = np.unique(
                image.points[used], return_inverse=True, return_counts=True
            )
            if (count > 1).any():
                if self.repeated == "refuse":
                    several = known(numbers[count > 1].tolist())
                    what = (
                        f"image {image.name!r} measures a point several times: points {several}; "
                        f"{option_text('repeated', 'leave out')} leaves these measurements out"
                    )
                    problems.append(Problem(what, image.where))
                    continue
                out += int(count[count > 1].sum())
                used = used[count[first] == 1]
            if not len(used):
                continue
            sigma = np.full((len(used), 2), self.sigma)
            if self.by_scale is not None:
                sigma *= self.by_scale[image.name][used, None] / unit
            point = np.array([number_of[p] for p in image.points[used].tolist()], dtype=np.intp)
            photo = np.full(len(used), network.photo_number[image.name], dtype=np.intp)
            network.images.append(photo, point, image.xy[used] * [1.0, -1.0], sigma)
        if problems:
            raise InputError(problems)
        return out

    def _mark(self, network: Network, mark: ControlMark) -> None:
        """Add an image point of a control point."""
        row = network.images.size
        sigma = self.sigma if mark.sigma is None else mark.sigma
        network.add_image_points(
            mark.photo, [mark.point], np.array([[mark.x, -mark.y]]), sigma=sigma
        )
        network.images.sources[row] = mark.where


READER = Reader(
    "colmap", (), "COLMAP", NetworkReader(read_colmap), folders=True, recognises=is_colmap
)
