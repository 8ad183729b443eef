"""The parser of the command line: for a wrong word it asks for the one that was meant."""

from __future__ import annotations

import argparse
import re
from importlib import import_module
from typing import Any, NoReturn

from ..errors import similar

_CHOICE = re.compile(r"invalid choice: '(.*?)' \(choose from (.*)\)")
_OPTION = re.compile(r"unrecognized arguments: (--[\w-]+)")


class Parser(argparse.ArgumentParser):
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
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                for command in action.choices.values():
                    out += command.options()
        return list(dict.fromkeys(out))


class Command(Parser):
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

    def filled(self) -> Command:
        """Return the parser with its arguments."""
        if self._left is not None:
            (module, function), self._left = self._left, None
            getattr(import_module(f".{module}", __package__), function)(self)
        return self

    def options(self) -> list[str]:
        """Return the options of the command."""
        return super(Command, self.filled()).options()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments of the command."""
        return super(Command, self.filled()).parse_known_args(args, namespace)
