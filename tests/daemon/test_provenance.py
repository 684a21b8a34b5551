"""A recording names the software that made it, and is sealed; heads of the seal are passed on."""

from __future__ import annotations

import asyncio
import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.errors import ConfigError
from robotctl.config import Config
from robotctl.daemon.recording import head_forwarder
from robotctl.daemon.recording.head_forwarder import HeadForwarder
from robotctl.daemon.recording.provenance import (
    CONTROL_PATH,
    DIGEST,
    provenance,
    revision,
    software,
)
from robotctl.daemon.recording.recordings_folder import open_recorder
from robotctl.recording import read_info
from robotctl.recording.format.names import FOXGLOVE_RECORD, SOFTWARE_RECORD
from robotctl.recording.seal import Head
from tests.support.waiting import DEADLINE_S, until
from tests.support.world import PATIENT, InProcess, World


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=n", "-c", "user.email=e@example.org"]
    ran = subprocess.run(
        ["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True
    )
    return ran.stdout.strip()


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    folder = tmp_path / "repository"
    folder.mkdir()
    try:
        git(folder, "init", "-q")
    except FileNotFoundError:
        pytest.skip("git is not installed")
    git(folder, "commit", "-q", "--allow-empty", "-m", "first")
    return folder


def test_a_revision_is_what_git_says(repository: Path) -> None:
    first = git(repository, "rev-parse", "HEAD")
    assert revision(repository) == first
    git(repository, "commit", "-q", "--allow-empty", "-m", "second")
    git(repository, "pack-refs", "--all")
    second = git(repository, "rev-parse", "HEAD")
    assert revision(repository) == second != first
    git(repository, "checkout", "-q", "--detach", first)
    assert revision(repository) == first
    git(repository, "worktree", "add", "-q", "-b", "other", "../worktree", second)
    assert revision(repository.parent / "worktree") == second


@pytest.mark.parametrize("head", [None, b"", b"\xff\xfe", b"ref: refs/heads/none\n", b"main"])
def test_what_is_no_repository_has_no_revision(tmp_path: Path, head: bytes | None) -> None:
    if head is not None:
        (tmp_path / ".git").mkdir()
        (tmp_path / ".git" / "HEAD").write_bytes(head)
    assert revision(tmp_path) == ""
    (tmp_path / "file").write_text("")
    assert revision(tmp_path / "file") == ""


def test_versions_and_host_are_named(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(repository)
    known = provenance()
    names = {"robotctl", "python", "ros_distro", "rmw", "rclpy", "mcap", "host", "directory"}
    assert names <= set(known)
    assert known["directory"] == str(repository)
    assert known["git.directory"] == git(repository, "rev-parse", "HEAD")
    assert all(known.values())


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the layout, with a few modules."""
    for part in CONTROL_PATH[:-1]:
        (tmp_path / "package" / part).mkdir(parents=True)
        (tmp_path / "package" / part / "module.py").write_text(f"name = {part!r}\n")
    return tmp_path / "package"


def test_the_hashes_name_the_module_that_differs(package: Path) -> None:
    before = software.__wrapped__(package)
    (package / "kernel" / "module.py").write_text("name = 'patched'\n")
    after = software.__wrapped__(package)
    differing = {name for name in before if before[name] != after[name]}
    assert differing == {DIGEST, "kernel/module.py"}


def test_the_digest_is_what_sha256sum_makes_of_its_own_list(package: Path) -> None:
    files = sorted(path.relative_to(package).as_posix() for path in package.rglob("*.py"))
    listed = subprocess.run(["sha256sum", *files], cwd=package, capture_output=True, check=True)
    assert software.__wrapped__(package)[DIGEST] == hashlib.sha256(listed.stdout).hexdigest()


def test_a_module_that_cannot_be_read_fails_no_start(package: Path) -> None:
    (package / "kernel" / "module.py").unlink()
    (package / "kernel" / "module.py").symlink_to("nothing")
    assert "kernel/module.py" not in software.__wrapped__(package)
    assert software.__wrapped__(package / "nowhere") == {}


def test_each_file_names_the_software_and_the_device(tmp_path: Path) -> None:
    fail: Any = pytest.fail
    recorder = open_recorder(tmp_path, "r2", Config(), lambda: "IDLE", fail, lambda _: None, fail)
    recorder.split()
    recorder.close()
    files = list(recorder.stats().file.parent.glob("*.mcap"))
    assert len(files) == 2
    for file in files:
        metadata = read_info(file).metadata
        assert metadata[SOFTWARE_RECORD] == software()
        assert metadata[FOXGLOVE_RECORD] == {"deviceName": "r2"}


async def test_without_a_place_for_the_key_the_robot_starts_and_says_so(
    in_process: InProcess, world: World
) -> None:
    blocked = world.folder / "state" / "robotctl" / "robot" / "seal"
    blocked.parent.mkdir(parents=True, mode=0o700)
    blocked.write_text("")
    async with in_process(observe=True, sim=None) as daemon:
        await daemon.until(lambda status: any("not sealed" in each for each in status["warnings"]))
    assert read_info(world.recording).missing == ()
    assert world.here("verify", str(world.recording)).exit_code == 4


def test_heads_are_published_and_given_to_a_program(world: World) -> None:
    kept = world.folder / "kept"
    program = world.folder / "keep"
    program.write_text(f"#!/bin/sh\necho $1 $2 >> {kept}\n")
    program.chmod(0o700)
    settings = f"recording.publish_heads: true\nrecording.head_command: {program}\n"
    world.ok("start", "--observe", settings=PATIENT + settings)
    until(lambda: kept.exists() and kept.read_text())
    until(lambda: any(each["name"] == "/robotctl/head" for each in world.status()["topics"]))
    world.ok("stop")
    head = kept.read_text().splitlines()[-1].split()[0]
    assert head == world.ok("key", "head").strip()
    world.ok("verify", str(world.recording), "--head", head)


def head(number: int) -> Head:
    return Head(file=f"run_{number}.mcap", number=number, digest=f"{number:064x}")


@pytest.mark.parametrize(
    ("command", "says"), [("/nowhere/at-all", "cannot be started"), ("false", "ended with 1")]
)
async def test_a_program_that_fails_is_told(command: str, says: str) -> None:
    forwarder = HeadForwarder(command, None)
    forwarder.take(head(1))
    await forwarder.finish()
    assert says in forwarder.problem


async def test_a_program_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(head_forwarder, "LAST_TIMEOUT_S", 0.05)
    forwarder = HeadForwarder(f'{sys.executable} -c "import time; time.sleep(600)"', None)
    forwarder.take(head(1))
    async with asyncio.timeout(DEADLINE_S):
        await forwarder.finish()
    assert "was ended" in forwarder.problem


def test_a_malformed_command_line_is_refused() -> None:
    with pytest.raises(ConfigError, match="head_command"):
        HeadForwarder('logger "', None)
