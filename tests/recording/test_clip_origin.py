"""A clip is compared with its source, message by message."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.cli import app
from robotctl.errors import UnreadableFile
from robotctl.kernel.types import Twist
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording
from robotctl.recording.keep.clip import Moment, cut_clip
from robotctl.recording.keep.clip_origin import compare_with_source
from robotctl.testing.drives import BEGIN_NS, START_NS, Written, drive, record

WRITTEN = drive(3.0, snapshots_s=(0.0, 1.5))
MIDDLE_NS = START_NS + BEGIN_NS + 2 * NS_PER_S


def clip_of(folder: Path, target: Path) -> Path:
    """Cut the second from 1.5 s to 2.5 s."""
    window = (MIDDLE_NS - NS_PER_S // 2, MIDDLE_NS + NS_PER_S // 2)
    with Recording(folder) as recording:
        cut_clip(recording, Moment(MIDDLE_NS), window, target)
    return target


def with_a_faster_command(written: list[Written]) -> list[Written]:
    """Change one command in the middle of the clip."""
    moving = [at for at, each in enumerate(written) if isinstance(each, Twist)]
    at = moving[len(moving) * 2 // 3]
    return [*written[:at], Twist(0.55, 0.0), *written[at + 1 :]]


def test_a_clip_holds_what_its_source_holds(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", WRITTEN)
    origin = compare_with_source(clip_of(folder, tmp_path / "clip.mcap"), folder)
    assert origin.wrong == []
    assert origin.messages > 100


def test_a_clip_of_a_recording_that_was_changed_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = record(tmp_path / "run", WRITTEN)
    changed = record(tmp_path / "changed" / "run", with_a_faster_command(WRITTEN))
    clip = clip_of(changed, tmp_path / "clip.mcap")
    (sentence,) = compare_with_source(clip, folder).wrong
    assert "/cmd_vel is not the one of its source" in sentence
    assert app.run(["verify", str(clip), "--source", str(folder)]) == 7
    assert app.run(["verify", str(clip), "--source", str(changed)]) == 4  # it is not sealed
    assert "messages are those of" in capsys.readouterr().out


def test_what_is_no_clip_or_of_another_file_is_said(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", WRITTEN)
    with pytest.raises(UnreadableFile, match="does not say what it was cut from"):
        compare_with_source(folder, folder)
    other = record(tmp_path / "other", WRITTEN)
    clip = clip_of(other, tmp_path / "clip.mcap")
    assert compare_with_source(clip, folder).wrong == [
        "it was cut from other_0.mcap, which is not there"
    ]
