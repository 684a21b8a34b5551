"""recordings, recover and rm find the folder of the daemon; times as users type them.

info shows any MCAP, and says what is missing.
"""

from __future__ import annotations

import json
import os
import pty
from datetime import datetime
from pathlib import Path

import pytest

from robotctl.base.errors import Refused, UsageError
from robotctl.cli.commands.recordings.info import qos_text, remove
from robotctl.cli.targets.recordings import parse_moment
from robotctl.cli.ui import text
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import ERRORS, RecordedEvent
from robotctl.recording.keep.listing import CLIPS_FOLDER, set_kept
from robotctl.testing.drives import START_NS
from tests.cli.conftest import Cli, note_recordings
from tests.support.bags import ODOMETRY, SAMPLES, VOLATILE, Line, needs_samples, odometry, write_bag
from tests.support.recordings import Tape, read_strictly

OLDER, NEWER = "robot_20260101_120000", "robot_20260101_120000-2"


STOP = RecordedEvent(EventKind.EMERGENCY_STOP, START_NS, "requested by \x1b[2J")


def begun(folder: Path, event: RecordedEvent = STOP) -> Tape:
    recorder = Tape(folder)
    recorder.commands(range(1, 101))
    recorder.add_event(event)
    return recorder


def record(folder: Path) -> Path:
    return begun(folder).close().file


@pytest.fixture
def library(tmp_path: Path) -> Path:
    """Create the folder of the robot's last daemon, with two recordings."""
    folder = tmp_path / "library"
    for name in (OLDER, NEWER):
        record(folder / name)
    note_recordings(folder)
    return folder


@pytest.mark.usefixtures("wide_terminal")
def test_the_list_is_that_of_the_last_daemon_from_any_directory(library: Path, cli: Cli) -> None:
    out = cli("recordings").succeeded()
    rows = [line.split() for line in out.splitlines()]
    assert [row[0] for row in rows[2:]] == [OLDER, NEWER]
    assert rows[2][3:] == [*rows[2][3:5], "0.1", "s", "0", "estop"]
    assert all(len(line) <= 80 for line in out.splitlines()[1:])


def test_the_list_for_machines_has_every_fact(library: Path, cli: Cli) -> None:
    found = cli("recordings", "--json").summary
    assert found["folder"] == str(library)
    first = found["recordings"][0]
    assert first == {
        "name": OLDER,
        "path": str(library / OLDER),
        "robot": None,
        "start_ns": START_NS + 1_000_000,
        "duration_s": 0.099,
        "size_bytes": first["size_bytes"],
        "files": 1,
        "laps": 0,
        "driven_s": None,
        **dict.fromkeys(ERRORS),
        "worst": "estop",
        "readable": True,
        "damage": [],
        "live": False,
        "kept": False,
        "clips": [],
    }


def test_the_list_tells_the_errors_and_the_time_of_drives_within_80_columns(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text, "_terminal_columns", lambda: 80)
    folder = tmp_path / "driven"
    names = ("cross_track_max_m", "heading_max_rad", "closure_m")
    errors = dict(zip(names, (0.021, 0.031, 0.005), strict=True))
    errors |= dict(zip((f"true_{name}" for name in names), (0.024, 0.034, 0.006), strict=True))
    ended = RecordedEvent(
        EventKind.DRIVE_ENDED, START_NS, "drive finished: 1 lap", 1, **errors, drive_s=77.0
    )
    begun(folder / OLDER, ended).close()
    lines = cli("recordings", "--recordings", str(folder)).out.splitlines()
    assert max(map(len, lines[1:])) <= 80
    assert [line.strip() for line in lines[3:]] == [
        "drives: 0.021 m off track (0.024 in truth), 0.031 rad off heading (0.034 in",
        "truth), 0.005 m closure (0.006 in truth), 1 min 17 s",
    ]
    (found,) = cli("recordings", "--recordings", str(folder), "--json").summary["recordings"]
    assert {name: found[name] for name in errors} == errors
    assert found["driven_s"] == 77.0


def test_another_folder_may_be_named(library: Path, cli: Cli, tmp_path: Path) -> None:
    record(tmp_path / "elsewhere" / "mine")
    assert "mine" in cli("recordings", "--recordings", str(tmp_path / "elsewhere")).out
    cli("recordings", "--recordings", str(tmp_path / "nowhere")).refused(2, "no such folder")


def test_keep_marks_a_recording_and_unkeep_takes_it_back(library: Path, cli: Cli) -> None:
    assert cli("recordings", "keep", OLDER).exit_code == 0
    answer = cli("recordings", "keep", "last", "--json").summary
    assert answer == {"path": str(library / NEWER), "kept": True}
    assert (library / OLDER / "keep").exists()
    assert (library / NEWER / "keep").exists()
    assert cli("recordings").out.count("kept") == 2
    assert cli("recordings", "unkeep", OLDER).exit_code == 0
    assert not (library / OLDER / "keep").exists()
    answer = cli("recordings", "unkeep", "last", "--json").summary
    assert answer == {"path": str(library / NEWER), "kept": False}
    ran = cli("recordings", "keep", "nothing")
    assert (ran.exit_code, ran.err.count("\n")) == (4, 1)


@pytest.mark.parametrize("command", ["keep", "unkeep"])
def test_an_option_before_keep_is_refused_and_nothing_is_changed(
    library: Path, cli: Cli, tmp_path: Path, command: str
) -> None:
    for option in (("--recordings", str(tmp_path)), ("--robot", "r2"), ("--json",)):
        err = cli("recordings", *option, command, "last").failed(2)
        told = (
            f"{option[0]} is given before {command}: give it after: robotctl recordings {command}"
        )
        assert told in err
    assert not list(library.glob("*/keep"))


HERE = "demo_7_20260102_120000"


def test_last_is_the_newest_in_the_folder_at_hand(library: Path, cli: Cli) -> None:
    record(Path("recordings") / "demo_7_20260101_120000")
    record(Path("recordings") / HERE)
    for command in ("info", "recover"):
        assert HERE in cli(command, "last").out
    assert HERE in cli("recordings").out
    assert OLDER not in cli("recordings").out
    assert "no recordings" in cli("recordings", "--recordings", "recordings", "--robot", "r2").out
    for options in (("--robot", "robot"), ("--recordings", str(library))):
        assert NEWER in cli("info", "last", *options).out
    assert cli("info", "last", "--recordings", "recordings", "--robot", "robot").exit_code == 4


def test_info_tells_machines_events_ledger_and_metadata(library: Path, cli: Cli) -> None:
    assert "estop        requested by \\x1b[2J" in cli("info", OLDER).out
    found = cli("info", OLDER, "--json").summary
    assert found["events"] == [
        {"kind": "estop", "time_ns": START_NS, "text": "requested by \x1b[2J"}
    ]
    counts = {"received": 100, "written": 100, "queued": 0, "dropped": 0, "lost": 0, "unseen": 0}
    assert found["ledger"] == {
        "/cmd_vel": {**counts, "bytes": 5200, "not_repeated": 0, "throttled": 0}
    }
    assert found["metadata"] == {"robotctl": {}}


def test_what_is_lost_is_said_and_is_the_exit_code(cli: Cli, tmp_path: Path) -> None:
    file = record(tmp_path / "run")
    ran = cli("recover", str(file))
    assert (ran.exit_code, ran.err) == (0, "")
    assert "100 messages saved, nothing lost" in ran.out
    assert len(read_strictly(tmp_path / "run_0_recovered.mcap")) == 100
    file.write_bytes(file.read_bytes()[:-30])
    out = tmp_path / "out.mcap"
    ran = cli("recover", str(file), "-o", str(out), "--json")
    ran.failed(8, f"robotctl: {file} could not be saved completely: ")
    found = ran.summary
    assert (found["target"], found["messages"]) == (str(out), 100)
    assert found["lost"]
    assert len(read_strictly(out)) == 100


def test_nothing_readable_is_exit_code_6_and_overwrites_nothing(cli: Cli, tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"nonsense" * 100)
    cli("recover", str(broken)).refused(6)
    assert sorted(tmp_path.glob("*.mcap")) == [broken]
    cli("recover", str(record(tmp_path / "run")), "-o", str(broken)).failed(4)
    assert broken.read_bytes() == b"nonsense" * 100


def test_a_folder_is_recovered_file_by_file(library: Path, cli: Cli) -> None:
    folder = library / OLDER
    file = folder / f"{OLDER}_0.mcap"
    (folder / f"{OLDER}_1.mcap").write_bytes(file.read_bytes()[:-30])
    (folder / f"{OLDER}_2.mcap").write_bytes(b"")
    cli("recover", OLDER).failed(
        8, f"{OLDER}_1.mcap: ", f"{OLDER}_2.mcap cannot be read: it is empty"
    )
    saved = library / f"{OLDER}_recovered"
    assert [len(read_strictly(path)) for path in sorted(saved.glob("*.mcap"))] == [100, 100]
    assert (saved / "metadata.yaml").exists()
    assert cli("info", str(saved)).exit_code == 0
    assert cli("recover", OLDER).exit_code == 4


@needs_samples
def test_bags_of_rosbag2_are_shown_recovered_and_cut(cli: Cli, tmp_path: Path) -> None:
    for bag in sorted(SAMPLES.iterdir()):
        found = cli("info", str(bag), "--json").summary
        assert found["messages"] > 0
        out = tmp_path / bag.name
        ran = cli("recover", str(bag), "-o", str(out), "--json")
        assert (ran.exit_code, ran.summary["messages"]) == (0, found["messages"])
        assert cli("info", str(out), "--json").summary["messages"] == found["messages"]
        clip = tmp_path / f"{bag.name}.mcap"
        cli(
            "clip", str(bag), "--at", "0", "--before", "0", "--after", "0.5", "-o", str(clip)
        ).succeeded()
        assert read_strictly(clip)
    listed = cli("recordings", "--recordings", str(SAMPLES), "--json").summary
    assert all(each["readable"] and not each["damage"] for each in listed["recordings"])
    assert len(listed["recordings"]) == len(list(SAMPLES.iterdir()))


NAME = "robot_20260101_120000"


@pytest.fixture
def open_recorder(tmp_path: Path) -> Tape:
    return begun(tmp_path / "cwd" / "recordings" / NAME)


@pytest.fixture
def with_clips(open_recorder: Tape) -> Path:
    file = open_recorder.close().file
    clips = file.parent / CLIPS_FOLDER
    clips.mkdir()
    (clips / "estop.mcap").write_bytes(file.read_bytes())
    return file.parent


def test_a_recording_goes_with_its_clips_and_the_rest_stays(with_clips: Path, cli: Cli) -> None:
    (with_clips / "notes.txt").write_text("mine")
    out = cli("recordings", "rm", NAME, "--yes", "--json").succeeded()
    assert json.loads(out)["removed_bytes"] > 1000
    assert [path.name for path in with_clips.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(("answer", "is_removed"), [("y", True), ("n", False), ("", False)])
def test_only_yes_means_yes(
    answer: str, is_removed: bool, with_clips: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, theirs = pty.openpty()
    os.write(ours, f"{answer}\n".encode())
    with os.fdopen(theirs, closefd=True) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        ran = cli("recordings", "rm", NAME)
    os.close(ours)
    assert ran.exit_code == (0 if is_removed else 130)
    assert with_clips.exists() is not is_removed


def test_a_kept_recording_and_without_a_terminal_each_is_refused(
    with_clips: Path, cli: Cli
) -> None:
    cli("recordings", "rm", "last").failed(2, "give --yes")
    set_kept(with_clips, True)
    cli("recordings", "rm", NAME, "--yes").failed(4, f"recordings unkeep {NAME}")
    assert with_clips.exists()


def test_a_recording_that_is_being_written_is_refused(open_recorder: Tape, cli: Cli) -> None:
    cli("recordings", "rm", NAME, "--yes").failed(4, "is being recorded")
    assert open_recorder.close().file.exists()


def test_a_folder_without_a_recording_and_a_link_are_refused(with_clips: Path) -> None:
    link, empty = with_clips.parent / "link", with_clips.parent / "empty"
    link.symlink_to(with_clips)
    empty.mkdir()
    for path in (link, empty, with_clips.parent / "none", next(with_clips.glob("*.mcap"))):
        with pytest.raises(Refused, match="is not the folder of a recording"):
            remove(path, without_asking=True)
    assert with_clips.exists()


START, END = "2026-01-01T23:50:00", "2026-01-02T00:20:00"


def ns(local_time: str) -> int:
    return round(datetime.fromisoformat(local_time).timestamp()) * 10**9


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("60", "2026-01-01T23:51:00"),
        ("23:55", "2026-01-01T23:55:00"),
        ("00:10:00", "2026-01-02T00:10:00"),
        ("00:20", END),
        ("00:21", "2026-01-01T00:21:00"),
        ("23:49:59", "2026-01-01T23:49:59"),
        ("2026-01-01T00:10", "2026-01-01T00:10:00"),
        ("2026-01-03", "2026-01-03T00:00:00"),
    ],
)
def test_a_time_of_day_is_that_of_the_next_day_only_where_the_recording_holds_it(
    text: str, meant: str
) -> None:
    assert parse_moment(text, ns(START), ns(END)) == ns(meant)


@pytest.mark.parametrize("text", ["noon", "", "25:00", "-1", "nan", "1e300", "2026-13-01"])
def test_what_is_no_time_is_a_usage_error(text: str) -> None:
    with pytest.raises(UsageError, match="give seconds into the recording"):
        parse_moment(text, ns(START), ns(END))


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    lines = [odometry(number * 10.0, 0.0) for number in range(101)]
    write_bag(folder / "run_0.mcap", [*lines, Line("/\x1b[2J", ODOMETRY, 1000.0, bytes(16), "")])
    return folder


def test_info_shows_topics_types_counts_rates_duration_and_qos(recording: Path, cli: Cli) -> None:
    for path in (recording, recording / "run_0.mcap"):
        out = cli("info", str(path)).succeeded(
            "  duration   1.0 s\n",
            "  messages   102\n",
            "    reliable, volatile, keep_last 10\n",
            "/\\x1b[2J",
        )
        odom = next(line for line in out.splitlines() if "/odom" in line)
        assert odom.split() == ["/odom", "nav_msgs/Odometry", "101", "101.0"]
        assert "\x1b" not in out


def test_a_truncated_file_shows_what_can_be_read_and_says_what_is_missing(
    recording: Path, cli: Cli, tmp_path: Path
) -> None:
    data = (recording / "run_0.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    ran = cli("info", str(cut))
    err = ran.failed(6, f"robotctl: {cut} is incomplete: ", out="index      missing")
    assert (err.count("\n"), "cut.mcap" in ran.out) == (1, True)
    assert cli("info", str(cut), "--json").summary["missing"]


@pytest.mark.parametrize(
    ("offered", "text"),
    [
        ("", ""),
        (VOLATILE, "reliable, volatile, keep_last 10"),
        (VOLATILE + VOLATILE, "reliable, volatile, keep_last 10"),
        (
            "- history: 3\n  depth: 0\n  reliability: 2\n  durability: 1\n" + VOLATILE,
            "best_effort, transient_local; reliable, volatile, keep_last 10",
        ),
        ("- history: keep_all\n  reliability: reliable", "reliable, keep_all"),
        ("- history: [", ""),
        ("- 3", ""),
        ("[]", ""),
        ("[" * 100_000, ""),
    ],
)
def test_qos_is_told_in_words_as_far_as_the_file_says(offered: str, text: str) -> None:
    assert qos_text(offered) == text
