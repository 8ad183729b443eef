"""A part of a network as files: texts of its project, arrays with its start, its junctions."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np

from ..graph.variables import Unknowns
from ..io.json_records import network_files, network_of
from ..network.network import Network
from ..solve.start import Start
from .folder import Folder
from .messages import Setup, Variable

NAME = "network"
"""Name of the arrays of a part in its folder."""
SETUP = "setup"
"""Name of what a part has to know about its junctions."""


def write_part(folder: Folder, network: Network, start: Start) -> None:
    """Write a network and its start, by arrays and JSON alone.

    Args:
        folder: folder of the part.
        network: the network.
        start: values of its unknowns.

    Raises:
        InputError: the network has something that no file can hold.
    """
    header = {
        "files": network_files(network),
        "words": start.words,
        "doubtful": start.doubtful,
        "unreached": start.unreached,
        "sources": {name: getattr(o, "source", None) for name, o in network.observations.items()},
    }
    text: Any = np.frombuffer(json.dumps(header).encode("utf-8"), dtype=np.uint8)
    state = {f"state/{kind}": x for kind, x in start.state.items()}
    origin = {f"origin/{kind}": x for kind, x in start.origin.items()}
    folder.write_arrays(NAME, {"header": text, **state, **origin})


def read_part(folder: Folder, geoids: Collection[str] = ()) -> tuple[Network, Start]:
    """Return a network and its start.

    Args:
        folder: folder of the part.
        geoids: paths of geoids that may be read although they lie outside.

    Raises:
        InputError: the files are missing, damaged, or of an earlier version.
    """
    arrays = folder.arrays(NAME)
    header = json.loads(arrays["header"].tobytes().decode("utf-8"))
    network = network_of(header["files"], geoids=geoids)
    for name, source in header["sources"].items():  # messages name the file that the user has
        own: Any = network.observations[name]
        network.observations[name] = replace(own, source=source)
    unknowns = Unknowns(network)
    state, origin = (
        {kind: arrays[f"{of}/{kind}"] for kind in unknowns.start()} for of in ("state", "origin")
    )
    words, doubtful, unreached = (tuple(header[n]) for n in ("words", "doubtful", "unreached"))
    return network, Start(unknowns, state, origin, words, doubtful, unreached)


def write_setup(folder: Folder, setup: Setup) -> None:
    """Write what a part has to know about its junctions."""
    record = {
        "variables": [[v.kind, v.name] for v in setup.variables],
        "start": [np.asarray(x).tolist() for x in setup.start],
        "foreign": [bool(f) for f in setup.foreign],
    }
    folder.write(SETUP, record)


def read_setup(folder: Folder) -> Setup:
    """Return what `write_setup` has written.

    Raises:
        InputError: the file is missing, damaged, or of an earlier version.
    """
    record = folder.read(SETUP)
    return Setup(
        tuple(Variable(kind, name) for kind, name in record["variables"]),
        tuple(np.array(x, dtype=float) for x in record["start"]),
        tuple(record["foreign"]),
    )
