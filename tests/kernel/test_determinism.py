"""The same events give the same effects, bit for bit: in any process, and from any snapshot."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

from robotctl.kernel.codec import Snapshot, from_json, to_json
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import Effect, Event
from robotctl.testing.kernels import drive_simulated, moving

HISTORY = """
import hashlib
from robotctl.kernel.codec import to_json
from robotctl.kernel.types import Cause, CommandPublishersSeen, FaultCleared, FaultReported
from robotctl.testing.kernels import moving
bench = moving(ticks=60)
bench.give(CommandPublishersSeen(bench.t_ns, ("/b", "/a", "/c")))
for cause in (Cause.TASK_DIED, Cause.LOOP_STALLED, Cause.RECORDER_FAILED):
    bench.give(FaultReported(bench.t_ns, cause, "broken"))
bench.give(FaultCleared(bench.t_ns, Cause.LOOP_STALLED))
for number in (0, 1, 2, 3, 4):
    bench.request(number)
lines = [to_json(effect) for effect in bench.effects] + [to_json(bench.state)]
print(len(lines), hashlib.sha256("".join(lines).encode()).hexdigest())
"""


def run_with_hash_seed(seed: int) -> str:
    return subprocess.run(
        [sys.executable, "-c", HISTORY],
        env={**os.environ, "PYTHONHASHSEED": str(seed)},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout


def test_the_hash_seed_changes_nothing() -> None:
    outputs = {run_with_hash_seed(seed) for seed in (0, 1, 4_294_967_295)}
    assert len(outputs) == 1


def test_events_fed_again_from_a_snapshot_in_their_midst_give_the_same_effects() -> None:
    driven = drive_simulated(Pattern(PatternKind.FIGURE_EIGHT, 0.3))
    kernel = Kernel(KernelParams())
    journal: list[tuple[Event, tuple[Effect, ...]]] = []
    snapshots: dict[int, str] = {}
    for number, event in enumerate(driven.events):
        if number % 300 == 0:
            snapshots[number] = to_json(Snapshot("test", kernel.params, kernel.state))
        journal.append((event, kernel.step(event)))
    assert len(snapshots) > 3
    for begin, text in snapshots.items():
        fresh = from_json(Snapshot, text).kernel()
        for event, effects in journal[begin:]:
            again: Any = from_json(type(event), to_json(event))
            assert fresh.step(again) == effects
        assert to_json(fresh.state) == to_json(kernel.state)


def test_a_step_leaves_the_state_before_it_untouched() -> None:
    bench = moving()
    before, text = bench.state, to_json(bench.state)
    bench.run(20)
    bench.request(0)
    assert to_json(before) == text != to_json(bench.state)
