"""No command reports a file as complete if a power cut has left zeros in it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.testing.drives import drive, record
from robotctl.testing.faults import chunks_of, zero

ZEROS = "the chunk was replaced by zeros, which a power cut can cause"


@pytest.fixture(scope="module")
def zeroed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    (path,) = record(tmp_path_factory.mktemp("cut") / "run", drive(3.0)).glob("*.mcap")
    chunks = chunks_of(path.read_bytes())
    assert len(chunks) > 4
    zero(path, *chunks[len(chunks) // 2])
    return path


def test_recover_exits_with_8(zeroed: Path, tmp_path: Path, cli: Callable[..., Any]) -> None:
    ran = cli("recover", str(zeroed), "-o", str(tmp_path / "out.mcap"))
    assert ran.exit_code == 8
    assert "nothing lost" not in ran.out
    assert ZEROS in ran.err


def test_clip_exits_with_8(zeroed: Path, tmp_path: Path, cli: Callable[..., Any]) -> None:
    options = ("--before", "86400", "--after", "86400", "-o", str(tmp_path / "clip.mcap"))
    ran = cli("clip", str(zeroed), "--at", "1", *options)
    assert ran.exit_code == 8, ran.err
    assert ZEROS in ran.err


@pytest.mark.parametrize("options", [("--check",), ("--what-if", "tracking.k_y=8")])
def test_a_check_is_incomplete(
    zeroed: Path, cli: Callable[..., Any], options: tuple[str, ...]
) -> None:
    ran = cli("replay", str(zeroed), "--json", *options)
    assert ran.exit_code == 6, ran.err
    assert ZEROS in ran.out


def test_why_says_what_is_missing(zeroed: Path, cli: Callable[..., Any]) -> None:
    ran = cli("why", str(zeroed), "--json")
    missing = json.loads(ran.out)["missing"] if ran.exit_code == 0 else [ran.err]
    assert any(ZEROS in sentence for sentence in missing)
