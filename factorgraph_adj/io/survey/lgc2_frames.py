"""Frames, points, bodies and mounts of LGC2 as those of a network; rotations of its frames."""

from __future__ import annotations

import numpy as np

from ...frames import LocalFrame
from ...network.network import Network
from ...observations import FrameCoordinate, HydrostaticReading
from ...rotation import log_rotation
from ...types import Array
from .lgc2_input import POINT_KEYWORDS, EarthModel, FrameNode, Lgc2Input, StatedPoint


class Lgc2Builder:
    """Makes frames and points of the network of an input."""

    def __init__(self, found: Lgc2Input, tiny: float) -> None:
        """Take what an input says; ``tiny`` is the standard deviation of conditions, metres."""
        self.found = found
        self.tiny = tiny
        self.earth: EarthModel = found.earth
        places = [self.place(p) for p in found.points.values()]
        near = np.mean(places, axis=0)
        self.network = Network(found.file.path.stem, frame=self.earth.frame(near))

    def frames_and_points(self) -> None:
        """Add frames that are free, and points; problems are noted in the file."""
        for node in self.found.nodes:
            outer = None if node.parent is None else node.parent.body()
            if node.free and outer is not None and not node.joined:
                self._attempt_frame(node, outer)
            elif node.free and not node.joined:
                self._attempt_frame(node, None)
        file = self.found.file
        if file.problems.count:
            return
        for point in self.found.points.values():
            with file.problems.collect(file.place(point.row.line)):
                self._point(point)

    def place(self, point: StatedPoint) -> Array:
        """Return the given or approximate place of a point, (3,)."""
        r, t = point.node.to(None)
        return np.asarray(r @ point.at + t)

    def _attempt_frame(self, node: FrameNode, outer: FrameNode | None) -> None:
        line = 0 if node.row is None else node.row.line
        with self.found.file.problems.collect(self.found.file.place(line)):
            if outer is not None:
                node.wrong(f"is free in the free frame {outer.name}, which is not read")
            inner = [n for n in self.found.nodes if n.joined and n.parent is node]
            self._free(node, inner)

    def _free(self, node: FrameNode, inner: list[FrameNode]) -> None:
        """State a free frame, whose origin is a point, with what is held of its translation."""
        assert node.parent is not None
        r, t = node.parent.to(None)
        rotation = r @ node.rotation
        free = [f for n in (node, *inner) for f in n.free]
        if len(inner) > 1:
            node.wrong(f"has {len(inner)} free frames in it; one can join it")
        turns = [f.lower() for f in free if f.startswith("R")]
        if inner:
            rotation = rotation @ inner[0].rotation
            if set(turns) != {"rx", "ry", "rz"}:
                node.wrong(
                    f"has, with the frame in it, the free rotations {turns}; valid: all three"
                )
        elif 1 < len(turns) < 3:
            node.wrong(f"has two free rotations {turns}; valid: none, one or three")
        elif turns in (["rx"], ["ry"]) and not _turns_about_own_axis(node, turns[0]):
            node.wrong(f"{turns[0]} is free, but is not about its own axis")
        origin = f"{node.name}/origin"
        held = [a for a in "xyz" if f"T{a.upper()}" not in free]
        at = r @ node.translation + t
        in_root = node.parent is self.found.root
        fixed = "xyz" if len(held) == 3 else "".join(held) if in_root else ""
        self.network.add_point(origin, at.tolist(), fixed=fixed)
        body = inner[0] if inner else node
        self.network.add_frame(
            body.name, free=turns, values=rotation_components(rotation), origin=origin
        )
        if held and not fixed:
            value = tuple(float(node.translation["xyz".index(a)]) for a in held)
            sigma = (self.tiny,) * len(held)
            name = self.held(node.parent)
            axes = "".join(held)
            self.network.add(FrameCoordinate(name, origin, value, axes=axes, sigma=sigma))

    def held(self, node: FrameNode) -> str:
        """Return the name of the held frame with the axes of a node that is fixed to the root."""
        name = f"{node.name} (held)"
        if name not in self.network.frames:
            r, t = node.to(None)
            self.network.add_frame(name, free=(), values=rotation_components(r), origin=t.tolist())
        return name

    def body(self, node: FrameNode) -> tuple[str, Array, Array, str]:
        """Return frame, rotation and translation into it, and name of the node's body."""
        around = node.body()
        if around is None:
            return self.held(node), np.eye(3), np.zeros(3), ""
        inner = [n for n in self.found.nodes if n.joined and n.parent is around]
        if inner and node is not inner[0] and node.body() is not inner[0]:
            node.wrong("is fixed to the outer one of two free frames, which is not read")
        return around.name, *node.to(around), around.name

    def mount(self, node: FrameNode) -> tuple[str, str | None]:
        """Return the body of a node, and the mount with the axes of the node on it."""
        frame, r, _, body = self.body(node)
        if not body or np.allclose(r, np.eye(3), atol=1e-15):
            return frame, None
        if node.name not in self.network.mounts:
            self.network.set_mount(node.name, values=rotation_components(r))
        return frame, node.name

    def _point(self, point: StatedPoint) -> None:
        at = self.place(point)
        fixed_to_root = point.node.body() is None
        keeps_height = point.kind == "VXY" and self.earth.kind != "OLOC"
        fixed = POINT_KEYWORDS[point.kind] if fixed_to_root and not keeps_height else ""
        name = point.row.words[0]
        self.network.add_point(name, at.tolist(), fixed=fixed)
        if keeps_height:
            level = f"H of {name}"
            self.network.set_level(level, self.earth.height(at), fixed=True)
            self.network.add(self.height(name, level, 0.0, self.tiny))
        if point.kind == "CALA" and not fixed_to_root:
            frame, r, t, _ = self.body(point.node)
            value = tuple((r @ point.at + t).tolist())
            self.network.add(FrameCoordinate(frame, name, value, sigma=(self.tiny,) * 3))

    def height(
        self,
        name: str,
        level: str,
        value: float,
        sigma: float,
        side: int = 1,
        source: str | None = None,
    ) -> HydrostaticReading:
        """Return a reading of the level over the earth model at a point."""
        x = np.array(self.network.points[name].coordinates, dtype=float)
        undulation = 0.0
        if self.earth.kind != "OLOC":
            frame = self.network.frame
            assert isinstance(frame, LocalFrame)
            d2 = float(np.sum((x - np.array(frame.origin))[:2] ** 2))
            undulation = float(x[2]) + d2 / (2 * frame.radius) - self.earth.height(x)
        return HydrostaticReading(
            name, level, value, sigma=sigma, side=side, undulation=undulation, source=source
        )


def rotation_components(rotation: Array) -> dict[str, float]:
    """Return a rotation (3, 3) as the vector that frames and mounts have, by name."""
    vector = log_rotation(rotation[None])[0]
    return dict(zip(("rx", "ry", "rz"), vector.tolist(), strict=True))


def _turns_about_own_axis(node: FrameNode, turn: str) -> bool:
    """Return whether a rotation that others follow is about the own axis of the frame."""
    axis = "xyz".index(turn[1])
    return bool(np.isclose(abs(node.rotation[axis, axis]), 1.0, atol=1e-15))
