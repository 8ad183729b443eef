"""Command ``completion``: the script with which a shell completes commands, options and files."""

from __future__ import annotations

import argparse
from importlib.util import find_spec

from ..errors import InputError
from .command_line import CommandParser, command_parser
from .messages import EXIT_FINE

SHELLS = ("bash", "zsh", "fish")
"""Shells whose scripts are written."""
SHTAB_MISSING = 'completion needs the extra completion: pip install "factorgraph_adj[completion]"'
FILES = frozenset(
    {"PROJECT", "FILE", "FIRST", "SECOND", "OUT", "TABLE", "CANDIDATES", "FILE.html", "PATH|N"}
)
"""Placeholders of files, or of files and folders."""
FOLDERS = frozenset({"FOLDER", "DIR"})
"""Placeholders of folders."""


def add_completion(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Print the script with which a shell completes commands, options, their choices and files. "
        "The script is fixed: print it again after an update."
    )
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))
    parser.set_defaults(run=_completion)


def _completion(options: argparse.Namespace) -> int:
    if find_spec("shtab") is None:
        raise InputError(SHTAB_MISSING)
    print(completion_script(options.shell))
    return EXIT_FINE


def completion_script(shell: str) -> str:
    """Return the script of a shell.

    A script that shtab makes once, and not a program that runs at every key: the completion
    neither waits for Python, nor does the command load anything for it.

    Args:
        shell: one of `SHELLS`.
    """
    import shtab

    parser = command_parser()
    for command in parser.commands():
        assert isinstance(command, CommandParser)
        for action in command.filled()._actions:
            kinds = {FILES: shtab.FILE, FOLDERS: shtab.DIRECTORY}
            for placeholders, completed in kinds.items():
                if action.metavar in placeholders:
                    action.complete = completed  # type: ignore[attr-defined]
    return str(shtab.complete(parser, shell=shell))
