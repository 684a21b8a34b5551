"""What may follow the words of a command line, by the tree of commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from robotctl.cli.completion.value_lists import ROBOT, plain, values_for
from robotctl.paths import DEFAULT_ROBOT


class Candidate(NamedTuple):
    """A word, and what it means; "" if there is nothing to say."""

    word: str
    meaning: str = ""


def candidates(root: Any, words: Sequence[str]) -> list[Candidate]:
    """Return what the last of `words` may become; `root` is the typer command.

    An empty list means that a file may follow.
    """
    *before, begin = [word for word in words if word != "="] or [""]
    at = _Place(root)
    for word in before:
        at.read(word)
    name, sign, value = begin.partition("=")
    if at.is_robot_next:
        return _robots(begin)
    if at.wanting is not None:
        return _values(at.wanting, at.robot, begin)
    if begin.startswith("-") and sign:
        found = _robots(value) if name == "--robot" else _values(at.option(name), at.robot, value)
        return [Candidate(f"{name}={each.word}") for each in found]
    if begin.startswith("-"):
        return _options(at.command, begin)
    if hasattr(at.command, "list_commands"):
        return _commands(at.command, begin)
    return _values(at.argument(), at.robot, begin)


class _Place:
    """Where the words lead to: a command, and the option whose value is next, if any."""

    def __init__(self, root: Any) -> None:
        self.command = root
        self.wanting: Any = None
        self.robot = DEFAULT_ROBOT
        self.is_robot_next = False
        self._arguments = 0

    def read(self, word: str) -> None:
        """Go on by one word."""
        name, _, value = word.partition("=")
        if self.is_robot_next:
            self.robot, self.is_robot_next = word, False
        elif self.wanting is not None:
            self.wanting = None
        elif name == "--robot":
            self.robot, self.is_robot_next = value or self.robot, not value
        elif word.startswith("-"):
            option = self.option(name)
            if option is not None and not option.is_flag and not value:
                self.wanting = option
        elif word in _names(self.command):
            self.command, self._arguments = self.command.get_command(None, word), 0
        else:
            self._arguments += 1

    def option(self, name: str) -> Any:
        """Return the option of that name, or None."""
        return next((each for each in self.command.params if name in each.opts), None)

    def argument(self) -> Any:
        """Return the argument that is next, or None; the last one of a command may take many."""
        arguments = [each for each in self.command.params if each.param_type_name == "argument"]
        if self._arguments < len(arguments):
            return arguments[self._arguments]
        return arguments[-1] if arguments and arguments[-1].nargs < 0 else None


def _names(command: Any) -> Sequence[str]:
    return command.list_commands(None) if hasattr(command, "list_commands") else ()


def _commands(group: Any, begin: str) -> list[Candidate]:
    return [
        Candidate(name, group.get_command(None, name).get_short_help_str(60))
        for name in plain(_names(group), begin)
    ]


def _options(command: Any, begin: str) -> list[Candidate]:
    shown = [each for each in command.params if not getattr(each, "hidden", True)]
    meanings = {name: each.help or "" for each in shown for name in each.opts if len(name) > 2}
    meanings["--help"] = "Show the help of this command."
    return [Candidate(name, meanings[name].split(". ")[0]) for name in plain(meanings, begin)]


def _robots(begin: str) -> list[Candidate]:
    return [Candidate(word) for word in values_for(ROBOT, DEFAULT_ROBOT, begin)]


def _values(parameter: Any, robot: str, begin: str) -> list[Candidate]:
    if parameter is None:
        return []
    if choices := getattr(parameter.type, "choices", None):
        return [Candidate(word) for word in plain(map(_text, choices), begin)]
    return [Candidate(word) for word in values_for(parameter.metavar or "", robot, begin)]


def _text(choice: Any) -> str:
    return str(getattr(choice, "value", choice))
