"""`robotctl why` with a real daemon: at once, after a kill, and after a restart."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robotctl.cli import app
from robotctl.daemon.api import recording
from robotctl.ipc.client import call
from robotctl.ipc.params import NoParams
from tests.support.waiting import until
from tests.support.world import World

ROUNDS = 5


@pytest.fixture
def here(world: World, monkeypatch: pytest.MonkeyPatch) -> World:
    """A world that commands in this process use as well."""
    for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "ROS_DOMAIN_ID"):
        monkeypatch.setenv(name, world.environment[name])
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
    here.ok("stop")


def test_the_running_daemon_comes_before_recordings_in_the_folder(
    here: World,
) -> None:
    here.ok("start", "--sim")
    call("robot", "set_mode", {"mode": 3, "source": "test"})
    elsewhere = here.folder / "elsewhere"
    older = "robot_20200101_120000"
    (elsewhere / "recordings" / older).mkdir(parents=True)
    (live,) = here.recordings.iterdir()
    process = here.spawn("why", "--json", cwd=elsewhere)
    found = json.loads(process.communicate()[0])
    assert found["path"] == str(live)
    here.ok("stop")


def test_why_knows_a_kill_while_moving_after_a_restart(here: World) -> None:
    here.ok("start", "--sim")
    here.ok("drive", "square")
    until(lambda: here.status()["velocity"]["linear"] > 0.1)
    received = here.status()["recorder"]["received"]
    # What a kill may lose, the last 0.3 s, is not to be the drive.
    until(lambda: here.status()["recorder"]["written"] >= received)
    (killed,) = here.recordings.iterdir()
    here.kill(here.status()["pid"])
    assert "the recording ends while MOVING: the daemon was killed" in here.ok("why")
    here.ok("start", "--sim")
    found = here.answer("why")
    assert found["kind"] == "kill"
    assert Path(found["path"]) == killed
    assert len(found["later"]) == 1
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
    monkeypatch.setattr(recording, "COMMIT_DEADLINE_S", 0.2)
    given: Any = recorder
    commit = recording.recording_methods(given, "robot")["record_commit"].handler
    answer: Any = await commit(NoParams())
    assert answer["uncommitted"] == uncommitted
    assert answer["failure"] == recorder.failure
