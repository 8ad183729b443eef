"""Command ``factorgraph-adj``: its table of commands, parsers that suggest words, exit codes.

Commands are new, check, convert, join, guess-columns, fetch-example, formats, compare, collocate,
adjust, plot, stream, serve, send, backup, restore, plan, propose, simulate-instrument, completion.
Each adds its arguments when it is called, and returns an exit code of `cli.messages`. Errors go to
stderr as a list, each problem on a line.
"""

from __future__ import annotations

import argparse
import io
import os
import re
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any, NoReturn

from ..control_characters import escaped
from ..errors import AdjustmentError, ApproximationError, InputError, Problem, known, similar
from ..files import FilesOfRun, keeping_inputs
from ..version import __version__
from .messages import (
    EXIT_BAD_INPUT,
    EXIT_CODES,
    EXIT_FAULT,
    EXIT_FINE,
    EXIT_INTERRUPTED,
    print_problems,
)

_CHOICE = re.compile(r"invalid choice: '(.*?)' \(choose from (.*)\)")
_OPTION = re.compile(r"unrecognized arguments: (--[\w-]+)")
_TEXT = io.TextIOWrapper
COMMAND_MODULES = {
    "adjust": ("adjustment", "add_adjust", "adjust a project and print the result"),
    "plot": ("adjustment", "add_plot", "adjust a project and draw it"),
    "stream": (
        "stream",
        "add_stream",
        "adjust observations as they arrive on standard input, one JSON line each",
    ),
    "serve": (
        "site_service",
        "add_serve",
        "serve a site: an API and a page for networks that grow while they are measured",
    ),
    "send": (
        "site_sending",
        "add_send",
        "send observations to a site: JSON lines of a file or of standard input",
    ),
    "backup": (
        "site_backup",
        "add_backup",
        "write a site into an archive, also while it is served",
    ),
    "restore": ("site_backup", "add_restore", "make a site of an archive"),
    "plan": ("design", "add_plan", "what a design will give; it needs no readings"),
    "propose": ("design", "add_propose", "the cheapest additions that meet the targets"),
    "new": ("new_project", "add_new", "make a project folder from the files of a survey"),
    "check": ("network_files", "add_check", "find every problem of the input"),
    "convert": ("network_files", "add_convert", "read a network in one format, write another"),
    "join": ("network_files", "add_join", "read several files of one object, write one network"),
    "guess-columns": (
        "column_map",
        "add_guess_columns",
        "print a mapping of the columns of a table, to correct",
    ),
    "fetch-example": (
        "example_network",
        "add_fetch_example",
        "copy an example network into a folder",
    ),
    "formats": ("formats", "add_formats", "list the formats that are read and written"),
    "compare": ("comparison", "add_compare", "adjust two epochs and tell what moved"),
    "collocate": (
        "collocation",
        "add_collocate",
        "correct all points by the residuals at control or check points",
    ),
    "refine": (
        "image_refinement",
        "add_refine",
        "correct image coordinates for refraction and curvature of the Earth",
    ),
    "simulate-instrument": (
        "instrument_simulation",
        "add_simulate_instrument",
        "simulate total stations on TCP ports, with faults to switch on",
    ),
    "completion": (
        "shell_completion",
        "add_completion",
        "print the script with which a shell completes the command",
    ),
}
"""Module, function that adds the arguments, and what each command does."""


class SuggestingParser(argparse.ArgumentParser):
    """A parser whose errors name the most similar command, choice or option."""

    def error(self, message: str) -> NoReturn:
        """End with a message, and what may have been meant."""
        if found := _CHOICE.search(message):
            message += similar(found[1], re.findall(r"'(.*?)'", found[2]))
        elif found := _OPTION.search(message):
            options = self.options()
            message += (
                f"; other commands have {found[1]}"
                if found[1] in options
                else similar(found[1], options)
            )
        super().error(message)

    def options(self) -> list[str]:
        """Return the options of the parser and of all its commands."""
        out = [name for name in self._option_string_actions if name.startswith("--")]
        for command in self.commands():
            out += command.options()
        return list(dict.fromkeys(out))

    def commands(self) -> Iterator[SuggestingParser]:
        """Yield the parsers of all its commands."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                yield from action.choices.values()


class CommandParser(SuggestingParser):
    """Parser of one command: its module is imported when its arguments are asked for.

    The list of commands and a wrong word need none of them.
    """

    def __init__(self, *, arguments: tuple[str, str] = ("", ""), **options: Any) -> None:
        """Take over where the arguments are added.

        Args:
            arguments: module beside this one, and its function of a parser.
            options: those of a parser.
        """
        super().__init__(**options)
        self._left: tuple[str, str] | None = arguments

    def filled(self) -> CommandParser:
        """Return the parser with its arguments."""
        if self._left is not None:
            (module, function), self._left = self._left, None
            getattr(import_module(f".{module}", __package__), function)(self)
        return self

    def options(self) -> list[str]:
        """Return the options of the command."""
        return super(CommandParser, self.filled()).options()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments of the command."""
        return super(CommandParser, self.filled()).parse_known_args(args, namespace)


class PipeTolerantStream:
    """A stream that writes to nothing once its reader has closed the pipe (… | head).

    The command goes on: its exit code says what it found, not how much of it was read. Control
    characters of texts from files become escapes; ``direct`` is the stream for programs that steer
    the terminal themselves.
    """

    def __init__(self, stream: io.TextIOWrapper) -> None:
        """Write to a stream."""
        self._stream = self.direct = stream

    def write(self, text: str) -> int:
        """Write a text."""
        try:
            return self._stream.write(escaped(text))
        except BrokenPipeError:
            self._forget()
            return len(text)

    def flush(self) -> None:
        """Write what is left."""
        try:
            self._stream.flush()
        except BrokenPipeError:
            self._forget()

    def _forget(self) -> None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the stream itself."""
        return getattr(self._stream, name)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    streams = {n: s for n in ("stdout", "stderr") if isinstance(s := getattr(sys, n), _TEXT)}
    for stream in streams.values():
        stream.reconfigure(errors="replace")  # the terminal's encoding may lack σ
    options = command_parser().parse_args(arguments)
    options.typed = list(sys.argv[1:] if arguments is None else arguments)
    if not options.ends_with_reader:
        for name, stream in streams.items():
            setattr(sys, name, PipeTolerantStream(stream))
    with keeping_inputs() as files:
        return _run(options, files)


def _run(options: argparse.Namespace, files: FilesOfRun) -> int:
    """Run the command of the options; return the exit code."""
    try:
        code = int(options.run(options))
        sys.stdout.flush()
        return code
    except (InputError, ApproximationError) as error:
        print_problems(error.problems)
        for note in getattr(error, "__notes__", ()):
            print(note, file=sys.stderr)
        return EXIT_BAD_INPUT
    except AdjustmentError as error:
        print_problems([Problem(str(error))])
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print(f"interrupted: {_written(files)}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # nobody reads the answers of a stream any more
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FINE
    except Exception as error:
        if os.environ.get("FACTORGRAPH_ADJ_DEBUG"):
            raise
        print(
            f"factorgraph-adj failed: {type(error).__name__}: {error}\n"
            f"This is a fault of the program, not of the input; {_written(files)}. "
            "FACTORGRAPH_ADJ_DEBUG=1 shows where.",
            file=sys.stderr,
        )
        return EXIT_FAULT


def _written(files: FilesOfRun) -> str:
    """Say what a run has written before it ended."""
    if not files.written:
        return "nothing was written"
    folders = known(dict.fromkeys(path.parent for path in files.written))
    n = len(files.written)
    return f"{n} file{'s are' if n > 1 else ' is'} written already, in {folders}"


def command_parser() -> SuggestingParser:
    """Return the parser of the command, with a parser for each of its commands."""
    parser = SuggestingParser(
        prog="factorgraph-adj",
        description="Combined adjustment of terrestrial and photogrammetric observations.",
        epilog=EXIT_CODES,
    )
    version = f"factorgraph-adj {__version__}".strip()
    parser.add_argument("--version", action="version", version=version)
    parser.set_defaults(ends_with_reader=False)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=CommandParser)
    for name, (module, function, what) in COMMAND_MODULES.items():
        commands.add_parser(name, help=what, arguments=(module, function))
    return parser


if __name__ == "__main__":
    sys.exit(main())
