"""`verify` of a folder and `evidence` agree on a file that stands in the place of a sealed one."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.errors import UnreadableFile
from robotctl.base.paths import make_private, seal_folder
from robotctl.decisions.journal import DecisionKind, log_folder
from robotctl.decisions.log import DecisionLog
from robotctl.recording import Recorder, RecorderOptions, read_info
from robotctl.recording.keep.recover import recover
from robotctl.recording.seal.keyring import Keyring
from robotctl.testing.drives import drive, record
from tests.support.edited_recordings import contents_of, write_contents
from tests.support.recordings import keyring
from tests.support.waiting import until

Cli = Callable[..., Any]

FIRST, SECOND = "robot_20260101_120000", "robot_20260102_120000"


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two sealed recordings that a journal of decisions names; `early.mcap` is an early copy
    of the first.
    """
    monkeypatch.setattr("robotctl.decisions.log.END_S", 30.0)
    monkeypatch.setattr(  # it takes seconds, and tells nothing of the seal
        "robotctl.rerun.check_many.check_recordings",
        lambda paths, on_progress: [{"verdict": "same"} for _ in paths],
    )
    folder = tmp_path / "runs"
    keys = Keyring(make_private(seal_folder("robot")), "robot")
    options = RecorderOptions(chunk_bytes=1 << 12, flush_s=0.005, sealer=keys)
    log = DecisionLog(log_folder("robot"), 0.0)
    written = drive(0.5)
    numbers = count()

    def copied() -> int:
        shutil.copy(file_of(folder), tmp_path / "early.mcap")
        with suppress(UnreadableFile):  # it is being written
            return read_info(tmp_path / "early.mcap").message_count
        return 0

    def copy_early(recorder: Recorder, _: int) -> None:
        half = len(written) // 2
        if next(numbers) == half:
            until(lambda: copied() == half)

    for name in (FIRST, SECOND):
        log.add(DecisionKind.START, by="ada", version="1", recording=str(folder / name))
        record(folder / name, written, options=options, beside=copy_early)
        log.add(DecisionKind.END)
    log.close()
    return folder


def file_of(runs: Path, name: str = FIRST) -> Path:
    return runs / name / f"{name}_0.mcap"


def early(runs: Path) -> None:
    (runs / FIRST / "metadata.yaml").unlink()
    (runs.parent / "early.mcap").replace(file_of(runs))


def another(runs: Path) -> None:
    (runs / FIRST / "metadata.yaml").unlink()
    file_of(runs, SECOND).replace(file_of(runs))
    shutil.rmtree(runs / SECOND)


def sealed_again(runs: Path) -> None:
    contents = contents_of(file_of(runs))
    shutil.rmtree(runs / FIRST)
    write_contents(runs / FIRST, contents, keyring(runs.parent / "attacker"))


def sealed_by_another_name(runs: Path) -> None:
    contents = contents_of(file_of(runs))
    shutil.rmtree(runs / FIRST)
    write_contents(runs / FIRST, contents, keyring(runs.parent / "attacker", "nobody"))


def without_a_seal(runs: Path) -> None:
    contents = contents_of(file_of(runs))
    shutil.rmtree(runs / FIRST)
    write_contents(runs / FIRST, contents)


def test_sealed_recordings_of_the_journal_exit_with_0(runs: Path, cli: Cli) -> None:
    assert cli("verify", str(runs)).exit_code == 0
    ran = cli("evidence")
    assert ran.exit_code == 0, ran
    assert ran.out.count("verify sealed, check same") == 2
    assert "this machine's list of keys knows 2 of 2 files" in ran.out


@pytest.mark.parametrize(
    ("put", "sentence"),
    [
        (early, "this machine knows another end of it"),
        (another, f"knows {FIRST}_0.mcap with another key"),
        (sealed_again, f"knows {FIRST}_0.mcap with another key"),
        (sealed_by_another_name, f"knows {FIRST}_0.mcap with another key"),
        (without_a_seal, "knows a seal of it, which is not there"),
    ],
)
def test_what_stands_in_the_place_of_a_sealed_file_exits_with_7(
    runs: Path, cli: Cli, put: Callable[[Path], None], sentence: str
) -> None:
    put(runs)
    for command in (("verify", str(runs)), ("evidence",)):
        ran = cli(*command)
        assert ran.exit_code == 7, ran
        assert sentence in " ".join(ran.out.split())
    items = json.loads(cli("evidence", "--json").out)["recordings"]
    assert items[0]["verify"] == "broken"


def test_two_copies_of_a_file_break_the_chain_of_both(runs: Path, cli: Cli) -> None:
    (runs / FIRST / "metadata.yaml").unlink()
    shutil.copy(file_of(runs, SECOND), file_of(runs))
    shutil.rmtree(seal_folder("robot"))
    ran = cli("evidence", "--json")
    assert ran.exit_code == 7
    assert "have the same place in the chain" in json.loads(ran.out)["verify"]["wrong"][0]


def test_recordings_may_be_verified_together_with_a_copy_of_them(
    runs: Path, cli: Cli, tmp_path: Path
) -> None:
    shutil.copytree(runs, tmp_path / "copy")
    ran = cli("verify", str(runs), str(tmp_path / "copy"))
    assert ran.exit_code == 0, ran


def test_verify_names_a_file_of_another_recording_also_without_a_list(runs: Path, cli: Cli) -> None:
    another(runs)
    shutil.rmtree(seal_folder("robot"))
    ran = cli("verify", str(runs))
    assert ran.exit_code == 0
    assert f"{FIRST}_0.mcap: it was sealed as {SECOND}_0.mcap" in " ".join(ran.out.split())


def test_a_renamed_folder_and_a_copy_elsewhere_stay_sealed(
    runs: Path, cli: Cli, tmp_path: Path
) -> None:
    shutil.copytree(runs / FIRST, tmp_path / "copy" / "accident")
    ran = cli("verify", str(tmp_path / "copy"))
    assert ran.exit_code == 0
    assert "it was sealed as" not in ran.out
    shutil.copy(file_of(runs), tmp_path / "stop.mcap")
    ran = cli("verify", str(tmp_path / "stop.mcap"))
    assert ran.exit_code == 0
    assert f"stop.mcap: it was sealed as {FIRST}_0.mcap: it was renamed" in ran.out


def test_a_repaired_copy_is_no_forgery_but_evidence_misses_its_seal(
    runs: Path, cli: Cli, tmp_path: Path
) -> None:
    recover(file_of(runs), tmp_path / "copy.mcap")
    assert cli("verify", str(tmp_path / "copy.mcap")).exit_code == 4
    (runs / FIRST / "metadata.yaml").unlink()
    (tmp_path / "copy.mcap").replace(file_of(runs))
    assert cli("verify", str(runs)).exit_code == 4
    ran = cli("evidence")
    assert ran.exit_code == 6
    assert "this machine knows its end, which no copy proves" in " ".join(ran.out.split())
