"""export and convert: formats, options, answers, exit codes."""

from __future__ import annotations

import csv
import io
import json
import os
import resource
import shutil
import subprocess
import sys
from math import inf, isnan, nan
from pathlib import Path
from typing import Any

import duckdb
import pytest

from robotctl.messages.definition import parse_definition
from robotctl.messages.fields import parse_path, value_at
from robotctl.messages.values import Decoder, encode
from robotctl.recording import Topic, arrays, read_info, read_messages
from robotctl.testing.drives import GID
from tests.cli.conftest import Cli
from tests.support.recordings import Tape, by_mcap

GOLDEN = Path(__file__).parents[1] / "golden"
DRIVE = GOLDEN / "stopped"
START_NS = 1_700_000_000_000_000_000

DEFINITION = """\
float64 x
string name
bool is_on
float32[2] pair
float64[] ranges
uint8[] image
Part[] parts
================================================================================
MSG: p/Part
float64 y
"""
TOPIC = Topic("/all", "p/msg/All", DEFINITION)


def parquet_of(cli: Cli, run: str) -> str:
    """Export the topic of a recording, and return the file."""
    target = f"{run}.parquet"
    assert cli("export", run, "--topic", "/all", "-o", target).exit_code == 0
    return target


def message(number: int) -> dict[str, Any]:
    return {
        "x": [0.1, nan, inf, -inf][number % 4],
        "name": f'{number}: a "quote", a comma\nand a line ä\0\x1b',
        "is_on": number % 2 == 0,
        "pair": [float(number), nan],
        "ranges": [nan, inf, 0.5][: number % 4],
        "image": bytes([number % 256, 255]),
        "parts": [{"y": nan}] * (number % 2),
    }


def written(folder: Path, count: int = 8) -> Path:
    """Return a recording with `count` messages, one second apart."""
    definition = parse_definition(TOPIC.type_name, DEFINITION)
    messages = (encode(definition, message(number)) for number in range(count))
    return recording_of(folder / "run", TOPIC, *messages)


def recording_of(folder: Path, topic: Topic, *messages: bytes) -> Path:
    """Record messages of a topic, one second apart; return the folder."""
    recorder = Tape(folder)
    channel = recorder.add_topic(topic)
    for number, data in enumerate(messages):
        log_ns = START_NS + number * 1_000_000_000
        recorder.write(channel, data, log_ns, log_ns - 5, 1, GID)
    recorder.close()
    return folder


def test_csv_holds_each_field_of_each_message_and_its_times(cli: Cli) -> None:
    ran = cli("export", str(DRIVE), "--topic", "/odom")
    assert (ran.exit_code, ran.err) == (0, "")
    assert "\r" not in ran.out
    rows = list(csv.DictReader(io.StringIO(ran.out)))
    info = next(each for each in read_info(DRIVE).topics if each.name == "/odom")
    definition = parse_definition(info.type_name, info.definition)
    messages = list(read_messages(DRIVE, {"/odom"}))
    assert len(rows) == len(messages) == info.message_count
    for row, recorded in zip(rows, messages, strict=True):
        assert int(row.pop("log_ns")) == recorded.log_ns
        assert int(row.pop("publish_ns")) == recorded.publish_ns
        assert float(row.pop("time_s")) >= 0
        values = Decoder(definition).values(recorded.data)
        for path, text in row.items():
            assert text == str(value_at(values, parse_path(definition, path).steps)), path


def test_csv_keeps_what_is_no_number_lists_bytes_and_any_text(cli: Cli, tmp_path: Path) -> None:
    ran = cli("export", str(written(tmp_path)), "--topic", "all", "--csv")
    rows = list(csv.DictReader(io.StringIO(ran.out, newline="")))
    assert [row["x"] for row in rows[:4]] == ["0.1", "nan", "inf", "-inf"]
    assert [row["name"] for row in rows] == [message(number)["name"] for number in range(8)]
    assert [row["is_on"] for row in rows[:2]] == ["True", "False"]
    assert [row["ranges"] for row in rows[:4:3]] == ["[]", '["NaN", "Infinity", 0.5]']
    assert rows[1]["parts"] == '[{"y": "NaN"}]'
    assert rows[1]["image"] == "Af8="
    assert [row["time_s"] for row in rows[:2]] == ["0.0", "1.0"]


def test_a_carriage_return_in_a_text_ends_no_row_of_csv(cli: Cli) -> None:
    topic = Topic("/text", "p/msg/Text", "string a\nstring b\n")
    texts = {"a": "one\rtwo", "b": "end\r"}
    data = encode(parse_definition(topic.type_name, topic.definition), texts)
    recording_of(Path("returns"), topic, data)
    assert cli("export", "returns", "--topic", "/text", "-o", "text.csv").exit_code == 0
    assert not Path("text.csv").read_bytes().endswith(b"\r\n")
    with Path("text.csv").open(newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert {name: row[name] for name in texts} == texts


def test_json_lines_are_valid_json_and_say_nan(cli: Cli, tmp_path: Path) -> None:
    ran = cli("export", str(written(tmp_path)), "--topic", "/all", "--json")

    def no_constant(text: str) -> None:
        raise AssertionError(text)

    rows = [json.loads(line, parse_constant=no_constant) for line in ran.out.splitlines()]
    assert [row["x"] for row in rows[:4]] == [0.1, "NaN", "Infinity", "-Infinity"]
    assert rows[3]["ranges"] == ["NaN", "Infinity", 0.5]
    assert (rows[1]["image"], rows[1]["parts"]) == ("Af8=", [{"y": "NaN"}])
    assert (rows[1]["log_ns"], rows[1]["publish_ns"]) == (START_NS + 10**9, START_NS + 10**9 - 5)


def test_parquet_has_the_types_and_values_of_the_messages(cli: Cli, tmp_path: Path) -> None:
    target = tmp_path / "o'ut.parquet"
    cli("export", str(written(tmp_path, 9)), "--topic", "/all", "-o", str(target)).succeeded()
    table = duckdb.read_parquet(str(target))
    assert dict(zip(table.columns, map(str, table.types), strict=True)) == {
        "log_ns": "BIGINT",
        "publish_ns": "BIGINT",
        "time_s": "DOUBLE",
        "x": "DOUBLE",
        "name": "VARCHAR",
        "is_on": "BOOLEAN",
        "pair[0]": "FLOAT",
        "pair[1]": "FLOAT",
        "ranges": "DOUBLE[]",
        "image": "BLOB",
        "parts": "VARCHAR",
    }
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.fetchall()]
    assert [row["log_ns"] for row in rows] == [START_NS + n * 10**9 for n in range(9)]
    for number, row in enumerate(rows):
        sent = message(number)
        for name in ("name", "is_on", "image"):
            assert row[name] == sent[name]
        assert row["x"] == sent["x"] or (isnan(row["x"]) and isnan(sent["x"]))
        assert isnan(row["pair[1]"])
        assert repr(row["ranges"]) == repr(sent["ranges"])
        assert row["parts"] == ('[{"y":"NaN"}]' if number % 2 else "[]")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cwd", "o'ut.parquet", "run"]


def test_without_duckdb_one_sentence_says_what_to_install(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "duckdb", None)
    err = cli("export", str(DRIVE), "--topic", "/odom", "-o", str(tmp_path / "x.parquet")).failed(2)
    assert err == (
        "robotctl: Parquet needs duckdb, which is not installed: pip install 'robotctl[parquet]'\n"
    )
    assert not list(tmp_path.glob("*parquet*"))


def test_ctrl_c_while_duckdb_writes_is_an_interruption(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise RuntimeError("Query interrupted")

    monkeypatch.setattr(arrays, "_copy", interrupted)
    ran = cli("export", str(DRIVE), "--topic", "/odom", "-o", str(tmp_path / "x.parquet"))
    assert (ran.exit_code, ran.err) == (130, "")
    assert not list(tmp_path.glob("*parquet*"))


def test_a_time_that_parquet_cannot_hold_is_named(cli: Cli, tmp_path: Path) -> None:
    data = encode(parse_definition("std_msgs/String", "string data"), {"data": ""})
    file = by_mcap(tmp_path / "late.mcap", [("/all", 2**63, data)], schema="std_msgs/String")
    ran = cli("export", str(file), "--topic", "/all", "-o", str(tmp_path / "x.parquet"))
    said = "robotctl: a time of a message is beyond the year 2262\n"
    assert (ran.exit_code, ran.err) == (6, said)


def test_a_full_disk_is_named_and_leaves_nothing(command: list[str], tmp_path: Path) -> None:
    """The limit of file sizes stands for the disk."""
    run = written(tmp_path, 3000)
    for name in ("x.csv", "x.parquet"):
        ran = subprocess.run(
            [*command, "export", str(run), "--topic", "/all", "-o", name],
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},  # the limit would cut the caches
            capture_output=True,
            text=True,
        )
        assert ran.returncode == 4
        assert ran.stderr == (
            f"robotctl: cannot write {name}: File too large: "
            "raise the limit of file sizes (ulimit -f)\n"
        )
    assert list(Path.cwd().iterdir()) == []


@pytest.mark.parametrize(
    ("name", "begin"),
    [("x.csv", "log_ns,"), ("x.jsonl", "{"), ("x.json", "{"), ("x.txt", "log_ns,")],
)
def test_the_files_name_chooses_the_format(cli: Cli, tmp_path: Path, name: str, begin: str) -> None:
    cli("export", str(DRIVE), "--topic", "/odom", "-o", str(tmp_path / name)).succeeded(
        "83 rows, 92 columns"
    )
    assert (tmp_path / name).read_text().startswith(begin)


def test_only_the_given_time_is_exported(cli: Cli, tmp_path: Path) -> None:
    run = str(written(tmp_path))
    ran = cli("export", run, "--topic", "/all", "--from", "2", "--to", "5", "--json")
    assert [json.loads(line)["time_s"] for line in ran.out.splitlines()] == [2.0, 3.0, 4.0, 5.0]
    nothing = cli("export", run, "--topic", "/all", "--from", "20")
    assert (nothing.exit_code, nothing.out.count("\n")) == (0, 1)
    target = str(tmp_path / "x.parquet")
    assert cli("export", run, "--topic", "/all", "--from", "20", "-o", target).exit_code == 0
    assert duckdb.read_parquet(target).types == duckdb.read_parquet(parquet_of(cli, run)).types


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--topic", "/odm"], f"no topic /odm in {DRIVE}: did you mean /odom?"),
        (["--topic", "/xyz"], f"no topic /xyz in {DRIVE}: see: robotctl topic list --file {DRIVE}"),
        (["--topic", "/odom", "--csv", "--json"], "--csv and --json: give one of them"),
        (["--topic", "/odom", "--parquet"], "--parquet needs a file: give one: -o FILE.parquet"),
        (["--topic", "/odom", "--from", "soon"], "--from soon is not a time: "),
        (["--topic", "/odom", "--from", "2", "--to", "1"], "--to 1 is before --from 2"),
        ([], "Missing option '--topic' (see: robotctl export --help)"),
    ],
)
def test_each_wrong_argument_has_a_cure(cli: Cli, arguments: list[str], sentence: str) -> None:
    err = cli("export", str(DRIVE), *arguments).failed(2)
    assert err.startswith(f"robotctl: {sentence}")


def test_no_file_is_overwritten_and_none_remains_after_a_failure(cli: Cli, tmp_path: Path) -> None:
    target = tmp_path / "kept.csv"
    target.write_text("mine")
    ran = cli("export", str(DRIVE), "--topic", "/odom", "-o", str(target))
    assert (ran.exit_code, target.read_text()) == (4, "mine")
    assert ran.err == f"robotctl: cannot write {target}: File exists: choose another name\n"
    missing = tmp_path / "nowhere" / "x.csv"
    assert cli("export", str(DRIVE), "--topic", "/odom", "-o", str(missing)).exit_code == 4
    link = tmp_path / "link.csv"
    link.symlink_to(tmp_path / "else.csv")
    assert cli("export", str(DRIVE), "--topic", "/odom", "-o", str(link)).exit_code == 4
    assert not (tmp_path / "else.csv").exists()
    assert sorted(path.name for path in tmp_path.glob("*.csv*")) == ["kept.csv", "link.csv"]


def test_the_file_is_private_as_its_recording(cli: Cli, tmp_path: Path) -> None:
    run = written(tmp_path)
    for mode, wanted in ((0o700, 0o600), (0o750, 0o640)):
        run.chmod(mode)
        target = tmp_path / f"{mode}.csv"
        assert cli("export", str(run), "--topic", "/all", "-o", str(target)).exit_code == 0
        assert target.stat().st_mode & 0o777 == wanted


def test_messages_that_do_not_fit_the_type_are_left_out_and_told(cli: Cli, tmp_path: Path) -> None:
    topic = Topic("/n", "p/msg/N", "int64 n\n")
    recording_of(tmp_path / "bad", topic, b"\0\1\0\0" + bytes(8), b"\0\1\0\0" + bytes(3))
    ran = cli("export", str(tmp_path / "bad"), "--topic", "/n")
    ran.failed(8, "1 messages of /n cannot be decoded")
    assert ran.out.count("\n") == 2


def test_a_field_with_the_name_of_a_time_has_a_column_of_its_own(cli: Cli, tmp_path: Path) -> None:
    topic = Topic("/n", "p/msg/N", "int64 log_ns\n")
    run = recording_of(tmp_path / "named", topic, b"\0\1\0\0\x07" + bytes(7))
    row = cli("export", str(run), "--topic", "/n", "--json").summary
    assert (row["log_ns"], row["message.log_ns"]) == (START_NS, 7)


def test_control_characters_reach_files_but_no_terminal(command: list[str], tmp_path: Path) -> None:
    run = written(tmp_path, 1)
    leader, follower = os.openpty()
    subprocess.run([*command, "export", str(run), "--topic", "/all"], stdout=follower, check=True)
    os.close(follower)
    shown = os.read(leader, 65536)
    os.close(leader)
    assert b"\x1b" not in shown
    assert b"0: a " in shown


def test_the_answer_names_the_new_files_and_counts_the_messages(cli: Cli, tmp_path: Path) -> None:
    target = tmp_path / "copy"
    ran = cli("convert", str(GOLDEN / "foreign"), str(target), "--json")
    assert (ran.exit_code, ran.err) == (0, "")
    assert ran.summary == {
        "source": str(GOLDEN / "foreign"),
        "target": str(target),
        "files": ["copy_0.mcap", "copy_1.mcap"],
        "messages": 586,
        "attachments": 0,
        "live": False,
        "lost": [],
    }
    ran = cli("convert", str(target), str(tmp_path / "one.mcap"), "--compression", "lz4")
    assert ran.out.endswith("one.mcap: 586 messages in 1 file\n")
    assert (tmp_path / "one.mcap").is_file()


def test_a_loss_is_told_and_is_code_8(cli: Cli, tmp_path: Path) -> None:
    shutil.copytree(GOLDEN / "foreign", tmp_path / "run")
    next((tmp_path / "run").glob("*_1.mcap")).unlink()
    cli("convert", str(tmp_path / "run"), str(tmp_path / "copy")).failed(
        8,
        "could not be converted completely: robot_20261122_041528_1.mcap",
        out="97 messages in 1 file",
    )


def test_of_a_recording_that_goes_on_the_answer_says_so(cli: Cli, tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run")
    ran = cli("convert", str(tmp_path / "run"), str(tmp_path / "copy"))
    recorder.close()
    assert ran.exit_code == 0
    assert ran.err == f"robotctl: {tmp_path}/run is still being recorded: the copy ends here\n"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["out", "--split-mb", "5", "--one-file"], "--split-mb makes several files: give a folder"),
        (["out.mcap", "--split-mb", "5"], "--split-mb makes several files: give a folder"),
        (["out", "--split-mb", "0"], "Invalid value for '--split-mb'"),
        (["out", "--compression", "zip"], "Invalid value for '--compression'"),
    ],
)
def test_options_that_do_not_fit_are_refused(cli: Cli, arguments: list[str], sentence: str) -> None:
    ran = cli("convert", str(GOLDEN / "stopped"), *arguments)
    assert (ran.exit_code, ran.err.startswith(f"robotctl: {sentence}")) == (2, True), ran.err
    assert not Path("out").exists()
