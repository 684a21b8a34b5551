"""Stored results of the gate: what is damaged is made again, and stays no obstacle."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.collection import judging
from robotctl.collection.judgement import judge
from robotctl.collection.judging import ResultStore
from robotctl.testing.drives import drive, record
from tests.support.checked_drives import judged

NAME = "robot_1"
SETTINGS = {"limits.linear_mps": "0.3"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    record(folder / NAME, drive(0.5))
    return folder


def sealed(change: Callable[[dict[str, Any]], object]) -> Callable[[bytes], bytes]:
    """Return a damage of the result whose hash is right, as a program that is wrong makes it."""

    def damaged(data: bytes) -> bytes:
        result = json.loads(data)["result"]
        change(result)
        text = json.dumps(result, sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()
        return json.dumps({"sha256": digest, "result": result}).encode()

    return damaged


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "half": lambda data: data[: len(data) // 2],
    "zeros": lambda data: bytes(len(data)),
    "no UTF-8": lambda data: b"\xff" + data,
    "another value": lambda data: b"[1]",
    "nested": lambda data: b"[" * 100_000,
    "another verdict": lambda data: data.replace(b'"same"', b'"broken"'),
    "a bit in a number": lambda data: data.replace(b'"ticks": 2', b'"ticks": 3'),
    "too large": lambda data: data + b" " * 100_000,
    "no such verdict": sealed(lambda result: result.update(verdict="fine")),
    "settings of None": sealed(lambda result: result.update(settings=None)),
    "a number as the hash": sealed(lambda result: result.update(recording=5)),
    "another recording": sealed(lambda result: result.update(recording="0" * 64)),
    "a number as the change": sealed(lambda result: result.update(other=5)),
    "a change without modes": sealed(lambda result: result["other"].pop("modes_s")),
    "a mode that is text": sealed(lambda result: result["other"]["modes_s"].update(IDLE="x")),
    "no cause": sealed(lambda result: result.pop("cause")),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_result_is_made_again(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    monkeypatch.setattr(judging, "MAX_BYTES", 50_000)
    results = ResultStore(tmp_path)
    result = results.put(judge(made / NAME, SETTINGS))
    assert results.get(result.key) == result
    (stored,) = tmp_path.iterdir()
    data = stored.read_bytes()
    damaged = DAMAGES[damage](data)
    assert damaged != data
    stored.write_bytes(damaged)
    assert results.get(result.key) is None
    assert results.put(result) == result
    assert results.get(result.key) == result


def test_no_thread_meets_a_class_that_is_not_prepared() -> None:
    """Two threads in which msgspec prepares the same class crash Python."""
    program = (
        "from robotctl.collection import gate, judgement, judging\n"
        "kinds = judging._Sealed, judgement.Judgement, judgement.Change, judgement.DriveChange\n"
        "kinds += judgement.Commanded, gate._File, gate.Accepted\n"
        "print([kind.__name__ for kind in kinds if '__msgspec_cache__' not in vars(kind)])"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert ran.stdout == "[]\n"


def test_programs_for_the_version_before_still_find_the_gate() -> None:
    program = (
        "from robotctl.fleet.baseline import Baseline\n"
        "from robotctl.fleet.gate import judge_all\n"
        "from robotctl.fleet.judging import judge_here\n"
        "from robotctl.fleet.result_store import ResultStore\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_run_over_damaged_results_judges_again_and_repairs_them(made: Path) -> None:
    first = judged(made)
    (stored,) = (made / ".gate").glob("*.json")
    stored.write_text('{"sha256": null}')
    second, third = judged(made), judged(made)
    assert (first.stored, second.stored, third.stored) == (0, 0, 1)
    assert first.results == second.results == third.results
