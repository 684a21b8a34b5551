"""clip finds the requested event in the requested recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from robotctl.recording import read_info
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.testing.drives import START_NS
from tests.cli.conftest import Cli, note_recordings
from tests.support.recordings import Tape, number_of, read_strictly

FIRST, SECOND = "robot_20260101_120000", "robot_20260102_120000"
COUNT = 4000
"""Messages 1 ms apart."""


def write(folder: Path, *events: tuple[EventKind, int]) -> None:
    recorder = Tape(folder)
    recorder.commands(range(1, COUNT + 1))
    for kind, at_ms in events:
        recorder.add_event(RecordedEvent(kind, START_NS + at_ms * 1_000_000, f"\x1b at {at_ms}"))
    recorder.close()


@pytest.fixture
def library(tmp_path: Path) -> Path:
    folder = tmp_path / "library"
    stop, error, mark = EventKind.EMERGENCY_STOP, EventKind.ERROR, EventKind.MARK
    write(folder / FIRST, (error, 500), (stop, 1000), (stop, 2000), (mark, 2500))
    write(folder / SECOND, (mark, 3000), (EventKind.DRIVE_ENDED, 3500))
    note_recordings(folder)
    return folder


def numbers(path: str) -> list[int]:
    return [number_of(message.data) for message in read_strictly(Path(path))]


@pytest.mark.parametrize(
    ("arguments", "name", "about", "window"),
    [
        ((), SECOND, "mark", (2000, 3500)),
        (("--event", "estop"), FIRST, "estop", (1000, 2500)),
        (("--event", "error"), FIRST, "error", (1, 1000)),
        ((FIRST,), FIRST, "mark", (1500, 3000)),
        (("last", "--event", "mark"), SECOND, "mark", (2000, 3500)),
        (("--at", "2.5"), SECOND, None, (1501, 3001)),
        ((FIRST, "--at", "0"), FIRST, None, (1, 501)),
    ],
)
def test_the_last_such_event_is_cut_out_of_the_newest_recording_that_has_one(
    arguments: tuple[str, ...],
    name: str,
    about: str | None,
    window: tuple[int, int],
    library: Path,
    cli: Cli,
) -> None:
    ran = cli("clip", *arguments, "--before", "1", "--after", "0.5", "--json")
    assert (ran.exit_code, ran.err) == (0, "")
    made = ran.summary
    assert (made["source"], made["event"]) == (str(library / name), about)
    assert Path(made["target"]).parent == library / name / "clips"
    assert numbers(made["target"]) == list(range(window[0], window[1] + 1))


def test_the_bag_and_its_count_stay_as_they_were(library: Path, cli: Cli) -> None:
    before = read_info(library / FIRST)
    assert cli("clip", FIRST).exit_code == 0
    assert cli("clip", FIRST).exit_code == 0
    clips = sorted(path.name for path in (library / FIRST / "clips").iterdir())
    assert len(clips) == 2
    assert clips[0].startswith(f"{FIRST}_mark_")
    after = read_info(library / FIRST)
    assert (after.message_count, after.files) == (before.message_count, before.files)
    assert "2 clips" in cli("recordings").out
    assert "\x1b" not in cli("clip", FIRST).out


def test_what_is_not_there_is_refused_in_a_sentence(library: Path, cli: Cli) -> None:
    for arguments, text in (
        (("last", "--event", "estop"), "there is no event 'estop' in"),
        (("--at", "100"), "no recording holds the time 100"),
        (("--recordings", "/"), "no recording in / "),
    ):
        cli("clip", *arguments).refused(4, text)
    ran = cli("clip", "nothing.mcap")
    assert (ran.exit_code, ran.err.count("\n")) == (6, 1)


@pytest.mark.parametrize(
    "arguments",
    [
        *("--at soon", "--at nan", "--at -5", "--at 99:99:99", "--before nan", "--after -1"),
        *("--before inf", "--event party", "--event mark --at 1"),
    ],
)
def test_nonsense_is_a_usage_error(arguments: str, library: Path, cli: Cli) -> None:
    cli("clip", *arguments.split()).refused(2)
