"""Command ``fetch-example``: copies an example network into a folder, or lists what there is."""

from __future__ import annotations

import argparse

from ..io.example_files import EXAMPLE_NETWORKS, fetch_example
from .messages import EXIT_FINE


def add_fetch_example(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    fetched = ", ".join(e.name for e in EXAMPLE_NETWORKS.values() if e.fetched)
    parser.add_argument(
        "name",
        metavar="NAME",
        nargs="?",
        help=f"name of the example; without it, list all. Needs the network: {fetched}",
    )
    parser.add_argument("folder", metavar="FOLDER", nargs="?", help="default: ./NAME")
    parser.set_defaults(run=_fetch)


def _fetch(options: argparse.Namespace) -> int:
    if options.name is None:
        for example in EXAMPLE_NETWORKS.values():
            needs = "; needs the network" if example.fetched else ""
            print(f"{example.name}: {example.description} ({example.licence}{needs})")
        return EXIT_FINE
    folder = fetch_example(options.name, options.folder)
    for path in sorted(folder.iterdir()):
        print(path)
    print(f"next: cd {folder} && factorgraph-adj {EXAMPLE_NETWORKS[options.name].command}")
    return EXIT_FINE
