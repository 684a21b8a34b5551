"""Where a new kernel decides differently than a journal tells."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.kernel.state import State


@dataclass(frozen=True, slots=True)
class Divergence:
    """The first place where a new kernel decided differently.

    `recorded` and `decided` are texts `Name {json}`, "" where one is missing, and `event` is what
    both kernels decided on. `seq` and `t_ns` are those of the recorded entry, `before` is the state
    of the new kernel before the event, and `differences` names the fields.
    """

    seq: int
    t_ns: int
    event: str
    recorded: str
    decided: str
    before: State | None
    differences: tuple[str, ...] = ()

    def sentence(self) -> str:
        """Return the difference in one sentence."""
        differs = "; ".join(self.differences)
        if not differs:
            differs = f"recorded {self.recorded or 'nothing'}, decided {self.decided or 'nothing'}"
        return f"entry {self.seq}, after {self.event.partition(' ')[0]}: {differs}"
