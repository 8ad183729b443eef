"""Example networks that may be distributed: in the package, in that of GTSAM, or in public.

Files of public repositories are fetched at one commit, and compared with their SHA-256: nothing is
written if one of them differs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

from ..errors import InputError, Problem, known
from .file_transaction import write_files

OWN_FILES = Path(str(files(__package__))) / "example_networks"
"""Folder of the examples of this package."""
FETCH_SECONDS = 60
"""Longest time of waiting for a server, seconds."""
MAX_FETCHED_BYTES = 50_000_000
"""Largest size of a file that is fetched."""
DYNADJUST = (
    "https://raw.githubusercontent.com/icsm-au/DynAdjust/"
    "0eda6d0dee5f00782bb1b4f3a0451dd0da0ff98d/sampleData/"
)


@dataclass(frozen=True)
class ExampleNetwork:
    """An example network."""

    name: str
    """Its name, and the usual name of its folder."""
    description: str
    """What was measured, by whom."""
    licence: str
    """Licence of the files."""
    command: str
    """Arguments of a command that adjusts it, in the folder of the example."""
    own: str = ""
    """Folder in `OWN_FILES`."""
    of_gtsam: tuple[str, ...] = ()
    """Names of files in the folder Data of GTSAM."""
    fetched: Mapping[str, str] = field(default_factory=dict)
    """Addresses of files, with their SHA-256."""


EXAMPLE_NETWORKS = {
    example.name: example
    for example in (
        ExampleNetwork(
            "level-loop",
            "four levelled height differences between two bench marks, a table with a mapping",
            "BSD-3-Clause, of this package",
            "adjust levels.csv --set mapping=map.toml",
            own="level_loop",
        ),
        ExampleNetwork(
            "total-station",
            "field book of a Leica total station, GSI-16, on a free station in two faces",
            "BSD-3-Clause, of this package",
            "adjust book.gsi --set fixed=A,B,C",
            own="total_station",
        ),
        ExampleNetwork(
            "photo-block",
            "five photos of Balbianello, 544 points, in the format of Bundler",
            "BSD-2-Clause, of GTSAM",
            "adjust Balbianello.out",
            of_gtsam=("Balbianello.out",),
        ),
        ExampleNetwork(
            "pose-graph",
            "100 poses of a vehicle in plan with 300 relative poses",
            "BSD-2-Clause, of GTSAM",
            "adjust w100.graph",
            of_gtsam=("w100.graph",),
        ),
        ExampleNetwork(
            "gnss-victoria",
            "43 stations and 417 components of GNSS vectors in Victoria, of DynAdjust's samples",
            "Apache-2.0, Geoscience Australia",
            "adjust gnss-network.stn",
            fetched={
                f"{DYNADJUST}gnss-network.stn": (
                    "4ee69ade4b3aad99b0e0d968b0e88e43091e7fcaebca7f3545b3b295d850df86"
                ),
                f"{DYNADJUST}gnss-network.msr": (
                    "b858dc88fff586ad7ee899dd574085bdd30c4cfce77f7f7dec5f43a114b3c4ba"
                ),
            },
        ),
    )
}
"""Examples by name."""


def fetch_example(name: str, folder: str | Path | None = None) -> Path:
    """Copy or fetch the files of an example network into a folder, and return the folder.

    Args:
        name: a name of `EXAMPLE_NETWORKS`: level-loop, total-station, photo-block, pose-graph,
            gnss-victoria, which is fetched from a public repository.
        folder: the folder, which is made; None: one of the name of the example here.

    Raises:
        InputError: there is no such example, the folder has files, or a file cannot be fetched or
            is not the one that was published; nothing is written then.
    """
    if name not in EXAMPLE_NETWORKS:
        valid = known(EXAMPLE_NETWORKS, meant=name, most=20)
        raise InputError(f"there is no example {name!r}; valid: {valid}")
    example = EXAMPLE_NETWORKS[name]
    out = Path(name if folder is None else folder)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(Problem("is there already: name another folder", str(out)))
    contents: dict[str, str | bytes | None] = {
        source.name: source.read_bytes() for source in _sources(example)
    }
    for address, sha in example.fetched.items():
        contents[address.rpartition("/")[2]] = _fetched(address, sha)
    contents["README.txt"] = _readme(example)
    write_files(out, contents)
    return out


def _sources(example: ExampleNetwork) -> list[Path]:
    """Return the files of this package and of GTSAM."""
    out = sorted((OWN_FILES / example.own).iterdir()) if example.own else []
    if example.of_gtsam:
        package = find_spec("gtsam")
        assert package is not None and package.origin is not None  # it is a requirement
        out += [Path(package.origin).parent / "Data" / file for file in example.of_gtsam]
    return out


def _fetched(address: str, sha: str) -> bytes:
    """Return the content of a file of a server.

    Raises:
        InputError: there is no connection, or the content is another one.
    """
    try:
        with urlopen(address, timeout=FETCH_SECONDS) as answer:  # the addresses are constants
            content = bytes(answer.read(MAX_FETCHED_BYTES))
    except (URLError, OSError) as error:
        reason = getattr(error, "reason", error)
        raise InputError(Problem(f"cannot be fetched: {reason}", address)) from None
    if hashlib.sha256(content).hexdigest() != sha:
        what = "is not the file that was published: its SHA-256 differs"
        raise InputError(Problem(what, address))
    return content


def _readme(example: ExampleNetwork) -> str:
    return (
        f"{example.name}: {example.description}.\nLicence: {example.licence}.\n\n"
        f"factorgraph-adj {example.command}\n"
    )
