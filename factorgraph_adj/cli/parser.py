"""The parser of the command line: for a wrong word it asks for the one that was meant."""

from __future__ import annotations

import argparse
import re
from typing import NoReturn

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
            options = self._options()
            message += (
                f"; other commands have {found[1]}"
                if found[1] in options
                else similar(found[1], options)
            )
        super().error(message)

    def _options(self) -> list[str]:
        """Return the options of the parser and of all its commands."""
        out = [name for name in self._option_string_actions if name.startswith("--")]
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                for command in action.choices.values():
                    out += command._options()
        return list(dict.fromkeys(out))
