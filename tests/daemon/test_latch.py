"""The emergency stop on the disk: written before it is confirmed, and in doubt a stop."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from robotctl.daemon.latch import Latch


async def test_a_latch_is_on_the_disk_before_it_is_confirmed(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "state" / "emergency-stop")
    assert latch.read() is None
    problems: list[str] = []
    latch.set("first")
    latch.set("second")
    latch.when_settled(problems.append)
    assert problems == []
    await latch.close()
    assert problems == [""]
    assert latch.read() == "second"
    assert [path.name for path in (tmp_path / "state").iterdir()] == ["emergency-stop"]


async def test_a_power_cut_leaves_the_old_latch_or_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, sync, synced = tmp_path / "emergency-stop", os.fsync, []

    def fsync(fd: int) -> None:
        synced.append((stat.S_ISDIR(os.fstat(fd).st_mode), path.exists()))
        sync(fd)

    monkeypatch.setattr(os, "fsync", fsync)
    latch = Latch(path)
    latch.set("reason")
    latch.clear()
    await latch.close()
    written, named, removed = (False, False), (True, True), (True, False)
    assert synced == [written, named, removed]


async def test_a_latch_that_is_released_is_gone(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "emergency-stop")
    latch.set("reason")
    latch.clear()
    await latch.close()
    assert latch.read() is None


async def test_a_latch_that_cannot_be_saved_says_why(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    latch = Latch(tmp_path / "file" / "emergency-stop")
    problems: list[str] = []
    latch.set("reason")
    latch.when_settled(problems.append)
    await latch.close()
    latch.when_settled(problems.append)  # as a second emergency stop does
    assert "the emergency-stop latch could not be saved" in problems[0]
    assert problems[1] == problems[0]


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"\0"])
def test_a_latch_that_a_power_cut_left_is_a_latched_stop(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "emergency-stop"
    path.write_bytes(content)
    assert Latch(path).read()


def test_a_latch_that_cannot_be_read_is_a_latched_stop(tmp_path: Path) -> None:
    (tmp_path / "emergency-stop").mkdir()
    assert "cannot be read" in str(Latch(tmp_path / "emergency-stop").read())
