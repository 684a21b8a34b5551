"""`robotctl sync`: to a folder and to S3, and copies of an earlier version, with its exit codes."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.base.errors import Interrupted, Refused
from robotctl.base.store.objects import has_hash_folders, hash_in, without_hashes
from robotctl.cli.commands.recordings import sync as sync_command
from robotctl.cli.commands.recordings.sync import SyncPace
from robotctl.ipc.client import NoAnswer
from robotctl.recording.keep.listing import recordings_in
from robotctl.testing.drives import drive, record
from tests.cli.conftest import Cli
from tests.support.stores import environment

Answers = list[str | Exception]
Say = Callable[..., Answers]

NAME = "robot_20260101_120000"


@pytest.fixture
def own_recording(tmp_path: Path) -> Path:
    return record(tmp_path / "cwd" / "recordings" / NAME, drive(0.3))


def stored(store: Path, file: str) -> Path:
    """Return the object that holds a file."""
    return store / NAME / file


def test_a_folder_takes_recordings_once(cli: Cli, own_recording: Path, tmp_path: Path) -> None:
    usb = tmp_path / "usb"
    cli("sync", str(usb), "--dry-run").succeeded("2 files", "would be copied")
    assert not usb.exists()
    assert "1 recordings are there; 2 files" in cli("sync", str(usb)).out
    again = cli("sync", str(usb), "--json")
    assert (again.exit_code, again.err) == (0, "")
    assert again.summary["copied"] == []
    assert cli("sync", str(usb), "--recordings", "recordings", "extra").exit_code == 2
    data = stored(usb, f"{NAME}_0.mcap")
    assert data.read_bytes() == (own_recording / data.name).read_bytes()


def test_what_is_not_copied_is_exit_code_6(cli: Cli, own_recording: Path, tmp_path: Path) -> None:
    (own_recording / f"{NAME}_1.mcap").symlink_to("/dev/null")
    ran = cli("sync", str(tmp_path / "usb"))
    ran.failed(6, out=f"{NAME}: {NAME}_1.mcap is left out: it is a link")
    assert "0 recordings are there; 2 files" in ran.out
    assert "nothing was copied now" in cli("sync", str(tmp_path / "usb")).out


def test_what_would_do_nothing_is_refused(cli: Cli, own_recording: Path, tmp_path: Path) -> None:
    packed = tmp_path / "run.mcap.zstd"
    packed.touch()
    cli("sync", str(packed), str(tmp_path / "usb")).failed(2, f"{packed} is no .mcap file")
    ran = cli("sync", str(own_recording), str(tmp_path / "usb"), "--max-age-days", "0")
    ran.failed(2, f"nothing can be removed from {own_recording}: give a folder of recordings")


def test_what_comes_back_from_a_bucket_is_as_it_was_with_its_time(
    cli: Cli, own_recording: Path, s3_endpoint: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name, value in environment(s3_endpoint).items():
        monkeypatch.setenv(name, value)
    (own_recording / f"{NAME}_1.mcap").write_bytes(
        (own_recording / f"{NAME}_0.mcap").read_bytes() * 400
    )
    for path in own_recording.iterdir():
        os.utime(path, (1_700_000_000, 1_700_000_000))  # a bucket lists when it was stored
    url = f"s3://robots/{tmp_path.name}"
    assert cli("sync", url).exit_code == 0
    back = tmp_path / "back"
    for place, target in ((url, back), (f"{url}/{NAME}", tmp_path / "one")):
        assert cli("sync", place, str(target)).exit_code == 0
        for path in own_recording.iterdir():
            copy = target / NAME / path.name
            assert copy.read_bytes() == path.read_bytes()
            assert copy.stat().st_mtime_ns == path.stat().st_mtime_ns
    cli("sync", url, str(back)).succeeded("nothing was missing")
    assert cli("sync", f"{url}/{NAME}/{NAME}_0.mcap", str(tmp_path / "file")).exit_code == 0
    assert [path.name for path in (tmp_path / "file").iterdir()] == [f"{NAME}_0.mcap"]
    gone = cli("sync", url, "--max-total-gb", "0", "--json").summary
    assert [Path(each).name for each in gone["removed"]] == [f"{NAME}_0.mcap", f"{NAME}_1.mcap"]
    assert not own_recording.exists()
    cli("sync", url, str(back), "--max-age-days", "0").failed(
        2, f"nothing can be removed from {url}"
    )


def test_an_object_that_was_changed_is_told_with_exit_code_7(
    cli: Cli, own_recording: Path, tmp_path: Path
) -> None:
    usb = tmp_path / "usb"
    cli("sync", str(usb))
    data = stored(usb, f"{NAME}_0.mcap")
    data.write_bytes(data.read_bytes()[:-1] + b"X")
    cli("sync", str(usb), "--max-age-days", "0").failed(
        7, out="has other content than the file here"
    )
    assert (own_recording / data.name).exists()


def test_a_full_disk_is_told_with_exit_code_6_and_the_rest_follows_later(
    cli: Cli, own_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        cli("sync", str(tmp_path / "usb")).failed(6, out="No space left")
    assert not [path for path in (tmp_path / "usb").rglob("*") if path.is_file()]
    assert cli("sync", str(tmp_path / "usb")).exit_code == 0


def test_no_network_is_told_with_exit_code_6(
    cli: Cli, own_recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from robotctl.base.store import bucket

    for name, value in environment("http://127.0.0.1:9").items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(bucket, "MAX_RETRIES", 1)
    cli("sync", "s3://robots/one").failed(6, "refuses the connection")


def test_a_folder_that_cannot_be_the_target_is_refused(
    cli: Cli, own_recording: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    for wrong in (tmp_path / "not" / "mounted", tmp_path / "file", own_recording.parent / "copy"):
        assert cli("sync", str(wrong)).exit_code == 2
    assert cli("sync", "").exit_code == 2


def test_without_the_extra_a_url_is_one_sentence_with_its_cure(
    cli: Cli, own_recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    cli("sync", "s3://robots/one").failed(2, "pip install 'robotctl[store]'")


def test_while_the_robot_moves_nothing_is_sent(
    cli: Cli, own_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    modes = ["MOVING", "MOVING", "IDLE"]
    seen: list[bool] = []

    def status(*_: object, **__: object) -> dict[str, str]:
        seen.append((tmp_path / "usb").exists())
        return {"mode": modes.pop(0)}

    monkeypatch.setattr(sync_command, "call", status)
    monkeypatch.setattr(sync_command, "_LOOK_EACH_S", 0.01)
    monkeypatch.setattr(sync_command.SyncPace, "_wait", lambda self, seconds: None)
    modes += ["IDLE"] * 100
    assert cli("sync", str(tmp_path / "usb"), "--pause-while-moving").exit_code == 0
    assert seen[:3] == [False, False, False]


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Say:
    """Return a function that lets the daemon answer with these modes and errors."""

    def say(*said: str | Exception) -> Answers:
        left = list(said)

        def status(*_: object, **__: object) -> dict[str, str]:
            answer = left.pop(0)
            if isinstance(answer, Exception):
                raise answer
            return {"mode": answer}

        monkeypatch.setattr(sync_command, "call", status)
        monkeypatch.setattr(SyncPace, "_wait", lambda self, seconds: None)
        return left

    return say


def test_the_end_of_a_run_ends_the_wait_of_another_thread() -> None:
    interrupted = threading.Event()

    def send(pace: SyncPace) -> None:
        try:
            pace(1_000_000_000)  # waits for days
        except Interrupted:
            interrupted.set()

    with SyncPace(0.01, None) as pace:
        threading.Thread(target=send, args=(pace,), daemon=True).start()
    assert interrupted.wait(30)


def test_a_daemon_that_does_not_tell_may_have_a_moving_robot(answers: Say) -> None:
    left = answers(
        "IDLE", NoAnswer("silent"), Refused("busy"), "MOVING", NoAnswer("silent"), "IDLE"
    )
    with SyncPace(None, "robot") as pace:
        pace(0)
    assert left == []


def test_a_daemon_that_cannot_be_asked_at_all_is_told_at_once(answers: Say) -> None:
    answers(Refused("the socket belongs to another user"))
    with pytest.raises(Refused, match="another user"), SyncPace(None, "robot"):
        pass


SHA = "0123456789abcdef" * 4


def copy_of(recording: Path, target: Path) -> Path:
    """Copy the files of a recording as RECORDING/SHA256/FILE."""
    for path in recording.iterdir():
        copy = target / hashlib.sha256(path.read_bytes()).hexdigest() / path.name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, copy)
    return target


def test_a_name_is_that_of_the_file_without_its_hash(tmp_path: Path) -> None:
    assert without_hashes(f"run/{SHA}/clips/a.mcap") == "run/clips/a.mcap"
    assert (hash_in(f"run/{SHA}/a.mcap"), hash_in("run/a.mcap")) == (SHA, "")
    (tmp_path / "usb" / "run" / SHA).mkdir(parents=True)
    (tmp_path / "plain" / "run" / "clips").mkdir(parents=True)
    assert has_hash_folders(tmp_path / "usb")
    assert has_hash_folders(tmp_path / "usb" / "run")
    assert not has_hash_folders(tmp_path / "plain")
    assert not has_hash_folders(tmp_path / "gone")


@pytest.fixture
def copies(tmp_path: Path) -> Path:
    golden = Path(__file__).parents[1] / "golden" / "stopped"
    copy_of(golden, tmp_path / "usb" / "robot_20261122_041522")
    return golden


def test_each_command_says_of_a_copy_what_it_says_of_the_recording(
    cli: Cli, copies: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "usb" / "robot_20261122_041522"
    for command in ("verify", "replay --check", "why", "info"):
        here, there = cli(*command.split(), str(copies)), cli(*command.split(), str(copy))
        assert (there.exit_code, there.err) == (here.exit_code, here.err)
        assert there.out.replace(str(copy), str(copies)) == here.out
    (file,) = copies.glob("*.mcap")
    info = cli("info", str(copy), "--json").summary
    assert [Path(each).name for each in info["files"]] == [file.name]
    assert recordings_in(copy.parent) == [copy]
    (checked,) = cli("replay", "--check", str(copy.parent), "--json").summary["recordings"]
    assert checked["path"] == str(copy)
    (gated,) = cli("gate", "--in", str(copy.parent), "--json").summary["recordings"]
    assert Path(gated["path"]).name == copy.name
