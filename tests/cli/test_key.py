"""`robotctl key`: what it shows, and that it never shows a secret."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.paths import make_private, seal_folder
from robotctl.recording.seal.keyring import KEY_FILE, Keyring
from tests.support.recordings import record_sealed

Cli = Callable[..., Any]


@pytest.fixture
def keys() -> Keyring:
    return Keyring(make_private(seal_folder("robot")), "robot")


def test_a_robot_that_never_started_has_no_key(cli: Cli) -> None:
    for command in ("show", "head", "rotate"):
        ran = cli("key", command)
        assert ran.exit_code == 4
        assert "no key yet" in ran.err
        assert not seal_folder("robot").exists()


def test_key_and_head_are_shown_without_the_secret(cli: Cli, keys: Keyring, tmp_path: Path) -> None:
    record_sealed(tmp_path / "run", keys)
    stored = keys.load()
    assert stored is not None
    shown = cli("key", "show")
    assert shown.exit_code == 0
    assert stored.root in shown.out
    assert cli("key", "head").out == f"{stored.head.digest}\n"
    assert json.loads(cli("key", "head", "--json").out)["file"] == "run_0.mcap"
    assert stored.seed not in shown.out + cli("key", "show", "--json").out


def test_a_head_that_is_known_proves_the_end(cli: Cli, keys: Keyring, tmp_path: Path) -> None:
    record_sealed(tmp_path / "run", keys)
    head = cli("key", "head").out.strip()
    ran = cli("verify", str(tmp_path / "run"), "--head", head)
    assert ran.exit_code == 0
    assert "the given head is in run_0.mcap" in ran.out
    assert "this machine's list of keys knows 1 of 1 files" in ran.out
    other = "0" * 63 + "1"
    assert cli("verify", str(tmp_path / "run"), "--head", other).exit_code == 7
    assert cli("verify", str(tmp_path / "run"), "--head", "12").exit_code == 2


def test_a_file_whose_end_this_machine_knows_otherwise_was_cut(
    cli: Cli, keys: Keyring, tmp_path: Path
) -> None:
    record_sealed(tmp_path / "run", keys)
    heads = seal_folder("robot") / "heads.jsonl"
    lines = [json.loads(line) for line in heads.read_text().splitlines()]
    lines[-1]["closed"]["digest"] = "0" * 64
    heads.write_text("".join(json.dumps(line) + "\n" for line in lines))
    ran = cli("verify", str(tmp_path / "run"))
    assert ran.exit_code == 7
    assert "a tail was cut or changed" in ran.out


def test_a_file_that_was_removed_is_named_by_the_list(
    cli: Cli, keys: Keyring, tmp_path: Path
) -> None:
    _, second, _ = record_sealed(tmp_path / "run", keys, splits=2)
    second.unlink()
    ran = cli("verify", str(tmp_path / "run"))
    assert "file 2 is not here, between run_0.mcap and run_2.mcap" in ran.out
    assert "knows file 2: it was run_1.mcap" in ran.out


def test_rotate_begins_a_new_chain(cli: Cli, keys: Keyring) -> None:
    before = keys.create()
    assert cli("key", "rotate").exit_code == 0
    after = keys.load()
    assert after is not None
    assert after.root != before.root


def test_a_damaged_key_is_refused_with_the_path(cli: Cli, keys: Keyring) -> None:
    keys.create()
    (seal_folder("robot") / KEY_FILE).write_text("?")
    ran = cli("key", "show")
    assert ran.exit_code == 4
    assert KEY_FILE in ran.err
