"""A shadow: a second kernel with other parameters that decides beside the driving one.

It takes the same events and commands nothing. The robot does not react to it: odometry is that of
the driving kernel's commands. So the state of the shadow can differ from the robot's only while the
robot is not in IDLE; in IDLE the shadow decides each event from the state of the driving kernel.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from enum import Enum
from typing import NamedTuple, assert_never

from robotctl.kernel.codec import to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.parameter_change import ParameterChanged, ParameterRequested
from robotctl.kernel.parameters import conflict, kernel_leaves, with_text
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    DriveEnded,
    Effect,
    Event,
    LatchEmergencyStop,
    ModeChanged,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
)


class Aspect(Enum):
    """What two decisions on one event differ in."""

    MODE = "mode"
    STOP_CAUSE = "stop cause"
    COMMAND = "command"
    ANSWER = "answer"
    """One kernel grants a request, and the other refuses it or has not answered it yet."""

    WORDING = "wording"
    """Only texts, or the figures of a drive."""


class Disagreement(NamedTuple):
    """One event on which the two kernels decided differently; `t_ns` is its steady time."""

    t_ns: int
    event: Event
    driving: tuple[Effect, ...]
    shadow: tuple[Effect, ...]
    aspects: tuple[Aspect, ...]


class Shadow:
    """The second kernel, and the counts of what it decides differently.

    `own` are the keys of the parameters that are the shadow's own. A change of another parameter
    while the kernels run applies to both.
    """

    def __init__(self, params: KernelParams, state: State, own: Container[str]) -> None:
        """Begin in `state`, that of the driving kernel."""
        self._kernel = Kernel(params, state)
        self._own = own
        self.steps = 0
        self.differing = 0
        """The steps with a disagreement."""

        self.by_aspect = dict.fromkeys(Aspect, 0)
        self.first: Disagreement | None = None
        self.last: Disagreement | None = None
        self.apart_since_ns: int | None = None
        """Since when the shadow has a future of its own [ns], None while it has none."""

    @property
    def state(self) -> State:
        """The state of the second kernel."""
        return self._kernel.state

    @property
    def params(self) -> KernelParams:
        """The parameters of the second kernel."""
        return self._kernel.params

    def step(
        self, event: Event, driving: tuple[Effect, ...], state: State
    ) -> tuple[Effect, ...] | None:
        """Decide on an event; return the effects, None where they are those of the driving kernel.

        `driving` are the effects of the driving kernel, and `state` is its state after the event.

        Raises:
            ValueError: A parameter of the driving kernel changed to a value that does not fit the
                shadow's own parameters.
        """
        self.steps += 1
        if isinstance(event, ParameterRequested):
            self._change(driving)
            return None
        mine = self._kernel.step(event)
        found = None if mine == driving else self._disagreement(event, driving, mine)
        if found is not None:
            self._count(found)
        if state.mode is Mode.IDLE:
            self._kernel.state = state
            self.apart_since_ns = None
        return None if found is None else mine

    def _change(self, driving: Sequence[Effect]) -> None:
        changes = [effect for effect in driving if isinstance(effect, ParameterChanged)]
        for change in changes:
            if change.key in kernel_leaves() and change.key not in self._own:
                params = with_text(self.params, change.key, change.new)
                if conflict(params) is not None:
                    raise ValueError(f"{change.key} = {change.new} does not fit its own parameters")
                self._kernel.params = params

    def _disagreement(
        self, event: Event, driving: tuple[Effect, ...], mine: tuple[Effect, ...]
    ) -> Disagreement | None:
        aspects = aspects_of(driving, mine)
        # As texts, because nan is not equal to nan.
        if aspects == (Aspect.WORDING,) and to_json(driving) == to_json(mine):
            return None
        return Disagreement(event.t_ns, event, driving, mine, aspects)

    def _count(self, found: Disagreement) -> None:
        self.differing += 1
        for aspect in found.aspects:
            self.by_aspect[aspect] += 1
        self.first = self.first or found
        self.last = found
        if self.apart_since_ns is None:
            self.apart_since_ns = found.t_ns


def aspects_of(driving: Sequence[Effect], shadow: Sequence[Effect]) -> tuple[Aspect, ...]:
    """Return what the effects of two kernels differ in, without any tolerance."""
    match driving, shadow:
        case (PublishTwist(),), (PublishTwist(),):  # nearly always
            return (Aspect.COMMAND,)
    ours, theirs = _told(driving), _told(shadow)
    return tuple(each for each in ours if ours[each] != theirs[each]) or (Aspect.WORDING,)


def _told(effects: Sequence[Effect]) -> dict[Aspect, list[object]]:
    told: dict[Aspect, list[object]] = {each: [] for each in Aspect if each is not Aspect.WORDING}
    for effect in effects:
        if isinstance(effect, PublishTwist):
            told[Aspect.COMMAND].append(effect.twist)
        elif isinstance(effect, ModeChanged):
            told[Aspect.MODE].append(effect.mode)
            if effect.cause is not None:
                told[Aspect.STOP_CAUSE].append(effect.cause)
        elif isinstance(effect, Reply):
            told[Aspect.ANSWER].append((effect.request_id, effect.ok))
    return told


def contrast(driving: Sequence[Effect], shadow: Sequence[Effect]) -> tuple[str, str]:
    """Return in words what only the driving kernel decided, and what only the shadow did."""
    return (
        outcome([effect for effect in driving if effect not in shadow]),
        outcome([effect for effect in shadow if effect not in driving]),
    )


def outcome(effects: Sequence[Effect]) -> str:
    """Return what a kernel decided, in words."""
    return "; ".join(map(_words, effects)) or "nothing"


def _words(effect: Effect) -> str:
    match effect:
        case PublishTwist():
            return f"{effect.twist.linear:.6g} m/s, {effect.twist.angular:.6g} rad/s"
        case ModeChanged():
            return f"{effect.mode.name}: {effect.reason}"
        case Reply():
            return f"{'granted' if effect.ok else 'refused'}: {effect.message}"
        case LatchEmergencyStop():
            return "latched"
        case ReleaseEmergencyStop():
            return "released"
        case DriveEnded():
            return "drive ended"
        case ParameterChanged():
            return f"{effect.key} = {effect.new}"
        case _:
            assert_never(effect)
