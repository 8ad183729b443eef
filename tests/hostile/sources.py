"""Undamaged inputs of every format: what they are, and the commands that read them."""

from __future__ import annotations

import bz2
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import factorgraph_adj as fga
from factorgraph_adj.io.json_records import observation_fields
from tests.field_mistakes.projects import facade, yard
from tests.hostile.examples import Example

GAMA = """<?xml version="1.0" ?>
<gama-local xmlns="http://www.gnu.org/software/gama/gama-local">
<network axes-xy="en" angles="left-handed">
<parameters sigma-apr="1" conf-pr="0.95" sigma-act="apriori" />
<points-observations distance-stdev="2" direction-stdev="10" zenith-angle-stdev="10">
<point id="A" x="0" y="0" z="10" fix="xyz" />
<point id="B" x="80" y="5" z="12" fix="xyz" />
<point id="C" x="70" y="60" z="15" fix="xyz" />
<point id="P" x="35" y="30" z="11" adj="xyz" />
<obs from="P">
<direction to="A" val="0.0000" />
<direction to="B" val="277.3954" />
<direction to="C" val="200.0000" />
<s-distance to="A" val="46.1086" />
<s-distance to="B" val="51.4888" />
<s-distance to="C" val="46.2709" />
<z-angle to="A" val="101.3807" />
<z-angle to="B" val="98.7634" />
</obs>
<height-differences>
<dh from="A" to="P" val="1.0002" stdev="1" />
</height-differences>
</points-observations>
</network>
</gama-local>
"""


@dataclass(frozen=True)
class Source:
    """An input in files, and how it is read."""

    name: str
    """Its format."""
    files: dict[str, bytes]
    """Content by file name."""
    command: Callable[[Path], list[str]]
    """(folder) → arguments of the command that reads it."""
    piped: str = ""
    """Name of the file that is standard input; empty: none."""


def _files(folder: Path) -> dict[str, bytes]:
    return {f.name: f.read_bytes() for f in sorted(folder.iterdir()) if f.is_file()}


def bal() -> bytes:
    """Return a small problem of Bundle Adjustment in the Large."""
    import numpy as np

    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (12, 3))
    cameras = [
        np.array([0.0, 0.1 * k, 0.0, 0.3 * k - 0.4, 0.05 * k, -5.0, 500.0, 0.0, 0.0])
        for k in range(4)
    ]
    lines = []
    for i, camera in enumerate(cameras):
        angle = camera[1]
        r = np.array(
            [
                [np.cos(angle), 0, np.sin(angle)],
                [0, 1, 0],
                [-np.sin(angle), 0, np.cos(angle)],
            ]
        )
        for j, x in enumerate(points):
            q = r @ x + camera[3:6]
            xy = -camera[6] * q[:2] / q[2] + 0.3 * rng.normal(size=2)
            lines.append(f"{i} {j} {xy[0]:.6f} {xy[1]:.6f}")
    numbers = [f"{v:.9f}" for v in np.concatenate([*cameras, points.ravel()])]
    text = [f"{len(cameras)} {len(points)} {len(lines)}", *lines, *numbers]
    return ("\n".join(text) + "\n").encode()


def sources(folder: Path) -> list[Source]:
    """Return one input of every format.

    Args:
        folder: an empty folder for what has to be written first.
    """
    out = []
    for name, project in (("project", yard()), ("project with photos", facade())):
        at = project.write(folder / name.replace(" ", "-"))
        for command in ("check", "adjust", "snoop"):
            arguments = ["adjust", "--snoop"] if command == "snoop" else [command]
            out.append(
                Source(
                    f"{name}, {command}",
                    _files(at),
                    lambda f, a=tuple(arguments): [a[0], str(f), *a[1:]],  # type: ignore[misc]
                )
            )
    for name, content in (("net.gkf", GAMA.encode()), ("problem.txt", bal())):
        out.append(
            Source(name, {name: content}, lambda f, n=name: ["adjust", str(f / n)])  # type: ignore[misc]
        )
    network = fga.read_project(folder / "project")
    observations = network.observations
    lines = [json.dumps(observation_fields(o, id=i)) for i, o in observations.items()]
    bare = yard()
    bare.tables.pop("observations.csv")
    at = bare.write(folder / "bare")
    stream = {**_files(at), "lines.jsonl": ("\n".join(lines) + "\n").encode()}
    out.append(Source("stream", stream, lambda f: ["stream", str(f)], "lines.jsonl"))
    journal = folder / "day.jsonl"
    inc = fga.IncrementalAdjustment(fga.read_project(at), journal=journal)
    every = list(observations.values())
    inc.add(every[:30])
    inc.add(every[30:])
    del inc
    resumed = {**_files(at), "day.jsonl": journal.read_bytes(), "lines.jsonl": b""}
    out.append(
        Source(
            "journal",
            resumed,
            lambda f: ["stream", str(f), "--journal", str(f / "day.jsonl"), "--resume"],
            "lines.jsonl",
        )
    )
    return out


EXAMPLE_FILES = {
    "gama": Example("gama", {"net.gkf": GAMA}, "net.gkf"),
    "bal": Example("bal", lambda _: {"problem.txt": bal()}, "problem.txt"),
    "bal packed": Example("bal", lambda _: {"p.txt.bz2": bz2.compress(bal())}, "p.txt.bz2"),
}
