"""What the kernel says, as the operator of one robot reads it.

The kernel knows no robot's name, and its texts are journaled: they are the same for every robot.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from robotctl.ipc.client import command_for
from robotctl.kernel.safety import RULES

_CURES = sorted({rule.cure for rule in RULES}, key=len, reverse=True)
_THEN_RESET = ", then robotctl reset"

_COMMAND = re.compile(r"\brobotctl (logs|reset|set-mode idle|start|status|stop)\b(?! \(uid )")
"""A command in a cure; what requesters call themselves goes on with their uid."""


class Advice(NamedTuple):
    """What is wrong, and what to do: "" where the text gives no rule's cure at its end."""

    cause: str
    cure: str

    @property
    def sentence(self) -> str:
        """Both in one line."""
        return f"{self.cause}: {self.cure}" if self.cure else self.cause


def advice(text: str, robot: str) -> Advice:
    """Return a text of the kernel with its cure told once, and with commands for this robot."""
    for rule_cure in _CURES:
        for cure in (rule_cure + _THEN_RESET, rule_cure):
            if text.endswith(f": {cure}"):
                cause = text.removesuffix(f": {cure}").replace(f": {rule_cure}", "")
                return Advice(cause, _for_robot(cure, robot))
    return Advice(_for_robot(text, robot), "")


def _for_robot(text: str, robot: str) -> str:
    return _COMMAND.sub(lambda match: command_for(robot, match[1]), text)
