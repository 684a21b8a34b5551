"""Copies of an earlier `robotctl sync`, each file in a folder named by its hash, are read."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.store import has_hash_folders, hash_in, without_hashes
from robotctl.recording.keep.listing import recordings_in

Cli = Callable[..., Any]

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
    info = json.loads(cli("info", str(copy), "--json").out)
    assert [Path(each).name for each in info["files"]] == [file.name]
    assert recordings_in(copy.parent) == [copy]
    (checked,) = json.loads(cli("replay", "--check", str(copy.parent), "--json").out)["recordings"]
    assert checked["path"] == str(copy)
    (gated,) = json.loads(cli("gate", "--in", str(copy.parent), "--json").out)["recordings"]
    assert Path(gated["path"]).name == copy.name


def test_the_newest_of_a_name_counts(copies: Path, cli: Cli, tmp_path: Path) -> None:
    copy = tmp_path / "usb" / "robot_20261122_041522"
    older = copy / SHA / "metadata.yaml"
    older.parent.mkdir()
    older.write_text("rosbag2_bagfile_information:\n")

    os.utime(older, (1, 1))
    assert cli("info", str(copy)).exit_code == 0
