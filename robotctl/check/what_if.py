"""What-if: the decisions of a kernel with other parameters on the recorded events.

The loop is open: the recorded robot does not react to the commands of the other kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from math import sqrt
from pathlib import Path
from typing import Any

from robotctl.base.errors import ConfigError, UnreadableFile, UsageError
from robotctl.check.journal import Gap, Step, decide, read_event, read_snapshot, steps, text_of
from robotctl.config import Config, check_together, flat, with_text
from robotctl.kernel.codec import Snapshot, finite_or_none
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.state import State
from robotctl.kernel.types import DriveEnded, Effect, Event, Reply, Tick
from robotctl.recording import Recording, RecordingInfo
from robotctl.recording.format.names import INFO_RECORD, PARAMETER_PREFIX
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.journal_reader import read_journal

_SECTIONS = frozenset(item.name for item in fields(Config))

Settings = Mapping[str, str]
"""Configuration keys and their values, as typed."""


def parse_settings(texts: Iterable[str]) -> Settings:
    """Return the settings of `key=value` texts.

    Raises:
        UsageError: A text is not `key=value`, or the value is not allowed for that key.
    """
    settings: dict[str, str] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals:
            raise UsageError(f"--what-if {text}", "give key=value, such as tracking.k_y=8")
        if key in settings:
            raise UsageError(f"--what-if {key}: stands twice: keep one of them")
        settings[key] = value
        try:
            with_text(Config(), key, value)
        except ConfigError as error:
            raise UsageError(f"--what-if {error}") from None
    return settings


def check_scope(settings: Settings, *, closed_loop: bool) -> None:
    """Check that every key changes the decisions or, with `closed_loop`, the simulated robot.

    Raises:
        UsageError: A key changes neither.
    """
    for key in settings:
        section = key.partition(".")[0]
        if key == "rate_hz" and not closed_loop:
            raise UsageError(
                "--what-if rate_hz: the ticks stay as recorded; with --resim the kernel ticks at "
                "that rate"
            )
        if section == "kernel" or section not in _SECTIONS or (closed_loop and section == "sim"):
            continue
        hint = "; with --resim it changes the simulated robot" if section == "sim" else ""
        raise UsageError(f"--what-if {key}: no decision depends on it{hint}")


def changed(config: Config, settings: Settings) -> Config:
    """Return the configuration with the settings applied.

    Raises:
        ConfigError: The settings do not fit together.
    """
    for key, value in settings.items():
        config = with_text(config, key, value)
    check_together(config.kernel)
    return config


def simulated(config: Config, info: RecordingInfo) -> tuple[Config, list[str]]:
    """Return `config` with the simulator parameters of a recording, and the keys not accepted."""
    unknown = []
    for name, value in info.metadata.get(INFO_RECORD, {}).items():
        key = name.removeprefix(PARAMETER_PREFIX)
        if key != name and key.startswith("sim."):
            try:
                config = with_text(config, key, value)
            except ConfigError:
                unknown.append(key)
    return config, unknown


@dataclass(slots=True)
class DriveCommands:
    """The commands of one kernel in one drive, from `begin_ns` (steady) on."""

    begin_ns: int
    in_mode_ns: dict[Mode, int] = field(default_factory=dict)
    commanded_m: float = 0.0
    largest_mps: float = 0.0
    largest_rps: float = 0.0
    end: DriveEnded | None = None
    end_mode: Mode | None = None
    has_path: bool = True

    def as_object(self) -> dict[str, Any]:
        """Return the commands of the drive as JSON values."""
        end = self.end
        return {
            "modes_s": {mode.name: ns / NS_PER_S for mode, ns in self.in_mode_ns.items()},
            "commanded_m": self.commanded_m,
            "max_linear_mps": self.largest_mps,
            "max_angular_rps": self.largest_rps,
            "duration_s": None if end is None else finite_or_none(end.report.duration_s),
            "completed": None if end is None else end.completed,
            "ended": None if end is None else end.reason,
            "cause": None if end is None or end.cause is None else end.cause.value,
            "end_mode": None if self.end_mode is None else self.end_mode.name,
        }

    def measured(self) -> dict[str, Any] | None:
        """Return the laps, distance and errors of the drive as JSON values; None before its end."""
        if self.end is None:
            return None
        report = self.end.report if self.has_path else self.end.report.without_errors()
        return {
            "laps": report.laps,
            "distance_m": finite_or_none(report.distance_m),
            "rms_error_m": finite_or_none(report.cross_track_rms_m),
            "max_error_m": finite_or_none(report.cross_track_max_m),
        }


def drives_of_both(
    recorded: Mapping[int, DriveCommands], other: Mapping[int, DriveCommands], begin_ns: int
) -> list[dict[str, Any]]:
    """Return the drives of two kernels, side by side, as JSON values, in the order of their begin.

    A drive is `None` on a side without it. `measured` is from the recorded commands alone.
    """

    def began_ns(request_id: int) -> int:
        sides = recorded.get(request_id), other.get(request_id)
        return min(each.begin_ns for each in sides if each is not None)

    found = []
    for number, request_id in enumerate(sorted(recorded.keys() | other.keys(), key=began_ns), 1):
        mine, theirs = recorded.get(request_id), other.get(request_id)
        found.append(
            {
                "drive": number,
                "request_id": request_id,
                "after_s": (began_ns(request_id) - begin_ns) / NS_PER_S,
                "measured": None if mine is None else mine.measured(),
                "recorded": None if mine is None else mine.as_object(),
                "what_if": None if theirs is None else theirs.as_object(),
            }
        )
    return found


MAX_ANSWERS = 20
"""The maximum number of listed pairs of different answers; all are counted."""


def what_if(
    path: Path,
    settings: Settings,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Compare recorded decisions with those under `settings`; return the `--what-if --json` object.

    `on_progress` is called with the bytes that are done and the bytes in total.

    Raises:
        UnreadableFile: The journal has no snapshot to begin from.
        ConfigError: The settings do not fit the recorded parameters.
    """
    missing: list[str] = []

    def miss(sentence: str) -> None:
        note_missing(missing, sentence)

    comparison = _TwoKernels(settings)
    with Recording(path) as recording:
        for sentence in recording.missing:
            miss(sentence)
        for item in steps(each.entry for each in read_journal(recording, miss, on_progress)):
            try:
                if isinstance(item, Gap):
                    raise UnreadableFile(item.text)
                if isinstance(item, Step):
                    comparison.step(read_event(item.event))
                else:
                    comparison.begin(item.t_ns, read_snapshot(item))
            except UnreadableFile as error:
                miss(str(error))
                comparison.stop()
    return {"path": str(path), **comparison.as_object(), "missing": missing}


@dataclass(slots=True)
class _Difference:
    """The difference of two series of numbers: its RMS and its largest value."""

    count: int = 0
    squares: float = 0.0
    largest: float = 0.0
    largest_ns: int = 0

    def add(self, difference: float, t_ns: int) -> None:
        self.count += 1
        self.squares += difference * difference
        if abs(difference) > self.largest:
            self.largest, self.largest_ns = abs(difference), t_ns

    def as_object(self, begin_ns: int) -> dict[str, Any]:
        return {
            "rms": sqrt(self.squares / self.count) if self.count else 0.0,
            "max": self.largest,
            "max_after_s": (self.largest_ns - begin_ns) / NS_PER_S if self.largest else None,
        }


@dataclass(slots=True)
class _Side:
    """One of the two kernels: its time in each mode, its drives, its open answers."""

    kernel: Kernel | None = None
    in_mode_ns: dict[Mode, int] = field(default_factory=lambda: dict.fromkeys(Mode, 0))
    answers: dict[int, Reply] = field(default_factory=dict)
    drives: dict[int, DriveCommands] = field(default_factory=dict)
    """The drives by the id of their request."""

    refusal: str = ""
    """The text of the last refusal."""

    @property
    def no_drive(self) -> str:
        """The reason why the robot never moved, or ""."""
        if self.in_mode_ns[Mode.MOVING]:
            return ""
        return f"refused: {self.refusal}" if self.refusal else "no motion was requested"

    def step(self, kernel: Kernel, event: Event, elapsed_ns: int) -> tuple[Effect, ...]:
        before = kernel.state
        self.in_mode_ns[before.mode] += elapsed_ns
        effects = decide(kernel, event)
        self._note_drive(before, kernel.state, effects, event.t_ns, elapsed_ns)
        for effect in effects:
            if isinstance(effect, Reply):
                self.answers[effect.request_id] = effect
                if not effect.ok:
                    self.refusal = effect.message
        return effects

    def _note_drive(
        self, before: State, after: State, effects: Iterable[Effect], t_ns: int, elapsed_ns: int
    ) -> None:
        """Add a step from `before` to `after` at `t_ns`, `elapsed_ns` after the previous step."""
        drive, following = before.drive, after.drive
        if drive is not None:
            present = self._drive(drive.request_id, t_ns - elapsed_ns)
            linear, angular = abs(before.command.linear), abs(before.command.angular)
            in_mode_ns = present.in_mode_ns
            in_mode_ns[before.mode] = in_mode_ns.get(before.mode, 0) + elapsed_ns
            present.commanded_m += linear * elapsed_ns / NS_PER_S
            present.largest_mps = max(present.largest_mps, linear)
            present.largest_rps = max(present.largest_rps, angular)
        if following is not None:
            if drive is not None and drive.request_id == following.request_id:
                return
            self._drive(following.request_id, t_ns)
        for effect in effects:
            if isinstance(effect, DriveEnded):
                ended = self._drive(effect.request_id, t_ns)
                ended.end, ended.end_mode = effect, after.mode
                ended.has_path = drive is None or bool(drive.path.segments)

    def _drive(self, request_id: int, begin_ns: int) -> DriveCommands:
        return self.drives.setdefault(request_id, DriveCommands(begin_ns))


class _TwoKernels:
    """Two kernels that decide on the same events: with the recorded parameters, and with others."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._before: dict[str, object] = {}
        self._recorded, self._other = _Side(), _Side()
        self._begin_ns: int | None = None
        self._t_ns = 0
        self._apart_ns = 0
        self._linear, self._angular = _Difference(), _Difference()
        self._first: dict[str, Any] | None = None
        self._failure: dict[str, Any] | None = None
        """The first event on which only the kernel with other parameters failed."""

        self._answers: list[dict[str, Any]] = []
        self._answer_count = 0

    def begin(self, t_ns: int, snapshot: Snapshot) -> None:
        """Start both kernels from a snapshot; while they run, further snapshots are ignored."""
        if self._recorded.kernel is not None:
            return
        config = Config(kernel=snapshot.params)
        if self._begin_ns is None:
            self._begin_ns = t_ns
            self._before = {key: flat(config)[key] for key in self._settings}
        self._t_ns = t_ns
        self._recorded.kernel = snapshot.kernel()
        self._other.kernel = Kernel(changed(config, self._settings).kernel, snapshot.state)

    def stop(self) -> None:
        """Drop both kernels until the next snapshot."""
        self._recorded.kernel = self._other.kernel = None

    def step(self, event: Event) -> None:
        """Step both kernels with an event."""
        kernel, other = self._recorded.kernel, self._other.kernel
        if kernel is None or other is None:
            return
        elapsed_ns, self._t_ns = event.t_ns - self._t_ns, event.t_ns
        if kernel.state.mode is not other.state.mode:
            self._apart_ns += elapsed_ns
        effects = self._recorded.step(kernel, event, elapsed_ns)
        try:
            others = self._other.step(other, event, elapsed_ns)
        except UnreadableFile as error:
            self._failure = self._failure or {**self._moment(event), "text": str(error)}
            raise
        if self._first is None and effects != others:
            self._first = {
                **self._moment(event),
                "event": text_of(event),
                "recorded": [text_of(effect) for effect in effects],
                "what_if": [text_of(effect) for effect in others],
            }
        if isinstance(event, Tick):
            command, another = kernel.state.command, other.state.command
            self._linear.add(another.linear - command.linear, event.t_ns)
            self._angular.add(another.angular - command.angular, event.t_ns)
        if self._recorded.answers and self._other.answers:
            self._compare_answers(event)

    def as_object(self) -> dict[str, Any]:
        """Return the comparison as JSON values.

        Raises:
            UnreadableFile: There was no snapshot to begin from.
        """
        if self._begin_ns is None:
            raise UnreadableFile("the journal holds no snapshot of the kernel to begin from")
        return {
            "duration_s": (self._t_ns - self._begin_ns) / NS_PER_S,
            "settings": {
                key: {"recorded": self._before[key], "what_if": value}
                for key, value in self._settings.items()
            },
            "ticks": self._linear.count,
            "linear_mps": self._linear.as_object(self._begin_ns),
            "angular_rps": self._angular.as_object(self._begin_ns),
            "modes_s": {
                mode.name: {
                    "recorded": self._recorded.in_mode_ns[mode] / NS_PER_S,
                    "what_if": self._other.in_mode_ns[mode] / NS_PER_S,
                }
                for mode in Mode
            },
            "mode_differs_s": self._apart_ns / NS_PER_S,
            "first_difference": self._first,
            "failure": self._failure,
            "drives": drives_of_both(self._recorded.drives, self._other.drives, self._begin_ns),
            "no_drive": {"recorded": self._recorded.no_drive, "what_if": self._other.no_drive},
            "answers": self._answers,
            "answer_count": self._answer_count,
        }

    def _compare_answers(self, event: Event) -> None:
        recorded, other = self._recorded.answers, self._other.answers
        for request_id in sorted(recorded.keys() & other.keys()):
            reply, another = recorded.pop(request_id), other.pop(request_id)
            if reply != another:
                self._answer_count += 1
                if len(self._answers) < MAX_ANSWERS:
                    self._answers.append(
                        {
                            **self._moment(event),
                            "request_id": request_id,
                            "recorded": reply.message,
                            "what_if": another.message,
                        }
                    )

    def _moment(self, event: Event) -> dict[str, float]:
        assert self._begin_ns is not None
        return {"after_s": (event.t_ns - self._begin_ns) / NS_PER_S}
