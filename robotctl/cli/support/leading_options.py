"""Options that many commands have may stand before the command, too."""

from __future__ import annotations

ENDS_OF_OPTIONS = ("--", "--ros-args")
"""Words after which no option of the command may stand."""


def behind_the_command(arguments: list[str]) -> list[str]:
    """Move --robot and --json from before the command to the end of its options.

    `--robot r2 topic list` becomes `topic list --robot r2`. Another option before the command
    stays where it is, with everything after it.
    """
    at = 0
    while at < len(arguments):
        if arguments[at] == "--json" or arguments[at].startswith("--robot="):
            at += 1
        elif arguments[at] == "--robot":
            at += 2
        else:
            break
    leading, rest = arguments[:at], arguments[at:]
    if not rest or rest[0].startswith("-"):
        return arguments
    end = min((rest.index(word) for word in ENDS_OF_OPTIONS if word in rest), default=len(rest))
    return rest[:end] + leading + rest[end:]
