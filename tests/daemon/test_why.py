"""`robotctl why` and the journal of decisions: who asked what, with which answer, and when."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robotctl import __version__
from robotctl.cli import app
from robotctl.config import Config, flat
from robotctl.daemon.api import status
from robotctl.daemon.control.decisions import Decisions, Request
from robotctl.daemon.recording.provenance import DIGEST, software
from robotctl.decisions.journal import DecisionKind, Entry, log_folder, read_log
from robotctl.ipc.client import call
from robotctl.ipc.method_names import RECORD_COMMIT
from robotctl.ipc.method_params import NoParams
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.types import (
    Cause,
    DriveRequested,
    ModeRequested,
    Odometry,
    OdomReceived,
    ParameterRequested,
    PublishTwist,
    ResetRequested,
    Twist,
)
from robotctl.testing.kernels import Bench, moving
from tests.support.waiting import until
from tests.support.world import World

ROUNDS = 2


@pytest.fixture
def here(world: World, monkeypatch: pytest.MonkeyPatch) -> World:
    """A world that commands in this process use as well."""
    world.enter(monkeypatch)
    monkeypatch.chdir(world.folder)
    return world


def test_why_knows_everything_that_the_daemon_has_answered_so_far(
    here: World, capsys: pytest.CaptureFixture[str]
) -> None:
    here.ok("start", "--sim")
    for number in range(ROUNDS):
        call("robot", "set_mode", {"mode": 3, "source": f"round {number}"})
        capsys.readouterr()
        assert app.run(["why", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["what"] == f"IDLE -> EMERGENCY_STOP: requested by round {number}"
        assert found["missing"] == []
        call("robot", "reset", {"source": "test"})
    elsewhere = here.folder / "elsewhere"
    (elsewhere / "recordings" / "robot_20200101_120000").mkdir(parents=True)
    process = here.spawn("why", "--json", cwd=elsewhere)
    found = json.loads(process.communicate()[0])
    assert found["path"] == str(here.recording), "the running daemon's"
    here.ok("stop")


class SlowDisk:
    """A recorder whose disk writes one message at each check, up to a limit."""

    def __init__(self, takes: int, failure: str = "") -> None:
        self.failure = failure
        self._written, self._takes = 0, takes

    def stats(self) -> Any:
        self._written = min(self._written + 1, self._takes)
        return SimpleNamespace(
            received=100 + self._written, written=self._written, dropped=95, file="/a/run_0.mcap"
        )


@pytest.mark.parametrize(
    ("recorder", "uncommitted"),
    [(SlowDisk(6), 0), (SlowDisk(2), 4), (SlowDisk(2, "recording stopped: disk full"), 4)],
    ids=["in time", "too slow", "failed"],
)
async def test_what_the_disk_did_not_take_is_counted(
    recorder: SlowDisk, uncommitted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status, "COMMIT_DEADLINE_S", 0.2)
    given: Any = recorder
    commit = status.recording_methods(given, "robot")["record_commit"].handler
    answer: Any = await commit(NoParams())
    assert answer["uncommitted"] == uncommitted
    assert answer["failure"] == recorder.failure


class Told:
    """A kernel whose requests and effects are told to a journal of decisions, which keeps them."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.kept: list[tuple[DecisionKind, dict[str, Any]]] = []
        self.decisions = Decisions(self)  # type: ignore[arg-type]
        self.next_id = 1000

    def add(self, kind: DecisionKind, **values: Any) -> None:
        self.kept.append((kind, values))

    def add_values(self, kind: DecisionKind, values: dict[str, Any]) -> None:
        self.kept.append((kind, values))

    def ask(self, kind: type[Any], *values: Any) -> None:
        self.next_id += 1
        request: Request = kind(self.bench.t_ns, self.next_id, *values)
        self.decisions.asked(request)
        self.tell(self.bench.give(request))

    def tell(self, effects: Any) -> None:
        for effect in effects:
            if not isinstance(effect, PublishTwist):
                self.decisions.decided(effect)

    def entries(self) -> list[tuple[DecisionKind, dict[str, Any]]]:
        entries, self.kept = self.kept, []
        return entries


@pytest.fixture
def told() -> Told:
    return Told(moving())


def test_a_stop_its_refusals_and_its_release_are_noted_with_who_asked(told: Told) -> None:
    told.ask(ModeRequested, Mode.EMERGENCY_STOP, "a person")
    stopped: dict[str, Any] = {
        "from": "MOVING",
        "to": "EMERGENCY_STOP",
        "reason": "requested by a person",
    }
    stopped |= {"cause": Cause.OPERATOR_STOP.value, "latched": True}
    answer = "Mode changed to EMERGENCY_STOP"
    assert told.entries() == [
        (DecisionKind.MODE, stopped),
        (DecisionKind.REQUEST, {"asked": "EMERGENCY_STOP", "by": "a person", "answer": answer}),
    ]
    told.ask(ModeRequested, Mode.MOVING, "a script")
    ((kind, values),) = told.entries()
    assert (kind, values["asked"], values["by"]) == (DecisionKind.REFUSED, "MOVING", "a script")
    told.ask(ResetRequested, "the person")
    (_, change), (kind, values) = told.entries()
    assert (change["to"], change["released"]) == ("IDLE", True)
    assert (kind, values["asked"], values["by"]) == (DecisionKind.REQUEST, "reset", "the person")


def test_what_changes_nothing_is_not_noted(told: Told) -> None:
    told.ask(ModeRequested, Mode.MOVING, "a node that asks again and again")
    told.tell(told.bench.give(OdomReceived(told.bench.t_ns, Odometry(ORIGIN, Twist(), 1))))
    assert told.entries() == []


def test_a_drive_that_replaces_another_is_noted(told: Told) -> None:
    told.ask(DriveRequested, Pattern(), 1, False, "first")
    assert [kind for kind, _ in told.entries()] == [DecisionKind.REFUSED]
    told.ask(DriveRequested, Pattern(), 1, True, "second")
    assert [(kind, values["by"]) for kind, values in told.entries()] == [
        (DecisionKind.REQUEST, "second")
    ]


def test_a_request_that_ramps_down_is_noted_when_it_is_answered(told: Told) -> None:
    told.ask(ModeRequested, Mode.IDLE, "a person")
    for _ in range(500):
        told.tell(told.bench.tick())
        if told.bench.state.mode is Mode.IDLE:
            break
        told.bench.odometry()
    kinds = [(kind, values.get("by")) for kind, values in told.entries()]
    assert kinds == [(DecisionKind.MODE, None), (DecisionKind.REQUEST, "a person")]


def test_a_changed_setting_is_noted_with_who_changed_it_and_a_refusal_too(told: Told) -> None:
    change = ("limits.linear_mps", "0.6", "0.3", "a person")
    told.ask(ParameterRequested, *change)
    ((kind, values),) = told.entries()
    assert kind is DecisionKind.REFUSED  # while MOVING
    assert (values["asked"], values["by"]) == ("limits.linear_mps = 0.3", "a person")
    told.ask(ModeRequested, Mode.EMERGENCY_STOP, "a person")
    told.entries()
    told.ask(ParameterRequested, *change)
    changed = {"key": "limits.linear_mps", "from": "0.6", "to": "0.3", "by": "a person"}
    assert told.entries() == [(DecisionKind.PARAMETER, changed)]


def of_kind(entries: list[Entry], kind: DecisionKind) -> list[Entry]:
    return [entry for entry in entries if entry.kind == kind]


def test_a_kill_while_moving_is_known_and_the_journal_outlives_daemons(here: World) -> None:
    here.ok("start", "--sim")
    call("robot", "set_mode", {"mode": 3, "source": "a person"})
    assert here.robotctl("set-mode", "moving").exit_code == 4
    here.ok("reset")
    here.ok("drive", "square")
    until(lambda: here.status()["velocity"]["linear"] > 0.1)
    until(lambda: len(of_kind(read_log(log_folder("robot")).entries, DecisionKind.REQUEST)) == 3)
    call("robot", RECORD_COMMIT)  # what a kill may lose, the last 0.3 s, is not to be the drive
    killed = here.recording
    here.kill(here.status()["pid"])
    assert "the recording ends while MOVING: the daemon was killed" in here.ok("why")
    here.patient.write_text(f"{here.patient.read_text()}limits.linear_mps: 0.3\n")
    here.ok("start", "--sim")
    found = here.answer("why")
    assert (found["kind"], Path(found["path"]), len(found["later"])) == ("kill", killed, 1)
    here.ok("stop")
    proof = here.answer("evidence")["recordings"]
    assert [each["check"] for each in proof] == ["same", "same"]
    verified = here.here("verify", str(here.recordings), "--head", here.ok("key", "head").strip())
    assert "broken" not in verified.out
    assert "2 of 2 files" in verified.out, "they are sealed over the kill"
    log = read_log(log_folder("robot"))
    assert (log.broken, log.notes) == ([], [])
    entries = log.entries
    starts = of_kind(entries, DecisionKind.START)
    (software_,) = of_kind(entries, DecisionKind.SOFTWARE)
    assert [entry.values["version"] for entry in starts] == [__version__] * 2
    assert software_.values[DIGEST] == software()[DIGEST]
    first, second = of_kind(entries, DecisionKind.CONFIGURATION)
    assert set(first.values) == set(flat(Config()))
    changed = {key for key, value in first.values.items() if second.values[key] != value}
    assert changed == {"limits.linear_mps"}
    assert of_kind(entries, DecisionKind.REQUEST)[0].values["by"] == "a person"
    assert len(of_kind(entries, DecisionKind.REFUSED)) == 1
    assert of_kind(entries, DecisionKind.MODE)[0].values["latched"] is True
    # The first daemon was killed: only the second one notes its end.
    assert entries[-1].kind == DecisionKind.END
    assert len(of_kind(entries, DecisionKind.END)) == 1
    recordings = {str(Path(entry.values["recording"]).parent) for entry in starts}
    assert recordings == {str(here.recordings)}
