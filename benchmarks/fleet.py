"""`robotctl find` over 10,000 recordings, the index of one, and a search of the MCAP files instead.

    python benchmarks/fleet.py                        5 rounds, some minutes
    python benchmarks/fleet.py --recordings 1000 --rounds 1
    python benchmarks/fleet.py --folder DIR           makes the indexes there, or uses those there

It needs `pip install 'robotctl[parquet]'`. A simulated drive of 3 minutes at 100 Hz is recorded,
and indexed as by a daemon that closes a recording. Then indexes of many recordings are generated: a
drive of a minute each, with different numbers, next to an empty file in place of the recording. A
question is one run of the command: the first without a catalogue, later ones with it. The search
reads the journal of one recording SAMPLE times, and is scaled to all recordings.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import duckdb
from recording.figures import Figure, Round, table
from recording.heard_drive import record_drive

from robotctl.base.jobs import job_command
from robotctl.check.journal import read_effect
from robotctl.collection.catalogue import CATALOGUE_NAME
from robotctl.collection.index_file import (
    index_path,
    name,
    stamp_of,
    table_columns,
    text,
    write_index,
)
from robotctl.collection.indexing import rows_of
from robotctl.daemon.recording.housekeeping import INDEX
from robotctl.kernel.types import DriveEnded
from robotctl.recording import Recording, read_journal

ROBOTCTL = str(Path(sys.executable).with_name("robotctl"))

RATE_HZ = 100.0
LONG_S = 180.0
SHORT_S = 60.0
SAMPLE = 5

CONDITION = "laps >= 1 and max_error_m > 0.1"

LATER_WALL = "a later question, wall clock [s]"
LATER_CPU = "a later question, CPU time [s]"
LATER_MEMORY = "a later question, most memory [MB]"
FIRST_WALL = "the first question, wall clock [s]"
FIRST_MEMORY = "the first question, most memory [MB]"
SQL_WALL = "a later question in SQL over all samples, wall clock [s]"
SEARCH = "a search of the MCAP files instead, from a sample [s]"
INDEX_CPU = "index at close: CPU time for an hour of driving [s]"
INDEX_SHARE = "index at close: size of that of three minutes [%]"

FIGURES = (
    Figure(LATER_WALL, 1.0),
    Figure(LATER_CPU),
    Figure(LATER_MEMORY, 200.0, digits=".0f"),
    Figure(FIRST_WALL),
    Figure(FIRST_MEMORY, digits=".0f"),
    Figure(SQL_WALL),
    Figure(SEARCH, digits=".0f"),
    Figure(INDEX_CPU, digits=".1f"),
    Figure(INDEX_SHARE, 2.0),
)


@dataclass(frozen=True, slots=True)
class Cost:
    """The wall time, CPU time and peak memory of one process."""

    wall_s: float
    cpu_s: float
    most_mb: float


def cost_of(command: Sequence[str], pass_fds: Sequence[int] = ()) -> Cost:
    """Run a command to its end, and return its cost."""
    begun_s = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, pass_fds=pass_fds)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(command[:3])} ended with {process.returncode}")
    wall_s = time.monotonic() - begun_s
    return Cost(wall_s, used.ru_utime + used.ru_stime, used.ru_maxrss / 1000)


def make_many(folder: Path, template: Path, count: int) -> None:
    """Make folders of recordings with indexes: the rows of `template`, with different numbers."""
    chance = random.Random(17)
    rows = rows_of(template, "same", None, "whole")
    write_index(folder.with_name("template.parquet"), "template", rows, "")
    others = ", ".join(map(name, [each for each in table_columns() if each not in CHANGED]))
    with duckdb.connect() as connection:
        source = text(folder.with_name("template.parquet"))
        connection.execute(f"CREATE TABLE rows AS SELECT * FROM {source}")
        for number in range(count):
            recording = folder / f"robot_{number:06}"
            recording.mkdir(parents=True)
            data = recording / f"{recording.name}_0.mcap"
            data.touch()
            changed = {
                "recording": text(recording.name),
                "stamp": f"CASE WHEN stamp IS NULL THEN NULL ELSE {text(stamp_of([data]))} END",
                "start_ns": f"start_ns + {number} * 3600000000000",
                "laps": f"CASE WHEN kind = 'drive' THEN {number % 5}::BIGINT ELSE laps END",
                "max_error_m": f"CASE WHEN kind = 'drive' THEN {chance.uniform(0.0, 0.2)}::DOUBLE "
                "ELSE max_error_m END",
            }
            shown = ", ".join(f"{value} AS {key}" for key, value in changed.items())
            connection.execute(
                f"COPY (SELECT {shown}, {others} FROM rows) TO {text(index_path(recording))} "
                "(FORMAT parquet, COMPRESSION zstd, PARQUET_VERSION v2)"
            )


CHANGED = ("recording", "stamp", "start_ns", "laps", "max_error_m")


def searched_s(template: Path) -> float:
    """Read the drives of a recording from its journal, and return the CPU time [s]."""
    begun_s = time.process_time()
    with Recording(template) as recording:
        entries = [entry for _, entry in read_journal(recording, sys.exit)]
    for entry in entries:
        if entry.name == "DriveEnded":
            ended = read_effect(entry)
            assert isinstance(ended, DriveEnded)
    return time.process_time() - begun_s


def indexed(recording: Path) -> tuple[float, float]:
    """Index a recording as the daemon does; return CPU time [s] and share of its size [%]."""
    index_path(recording).unlink(missing_ok=True)
    reports, reporting = os.pipe()
    command = job_command(INDEX, {"recording": str(recording)})
    cost = cost_of([*command, "--report-fd", str(reporting)], (reporting,))
    os.close(reporting)
    os.close(reports)
    size = sum(each.stat().st_size for each in recording.glob("*.mcap"))
    return cost.cpu_s, 100 * index_path(recording).stat().st_size / size


def one_round(many: Path, count: int, short: Path, long: Path) -> Round:
    """Measure every figure once."""
    (many / CATALOGUE_NAME).unlink(missing_ok=True)
    question = (ROBOTCTL, "find", CONDITION, "--in", str(many), "--json")
    first, later = cost_of(question), cost_of(question)
    sql = "SELECT count(*), max(error_m) FROM samples"
    samples = cost_of((ROBOTCTL, "find", "--sql", sql, "--in", str(many), "--json"))
    index_s, share = indexed(long)
    return {
        LATER_WALL: later.wall_s,
        LATER_CPU: later.cpu_s,
        LATER_MEMORY: later.most_mb,
        FIRST_WALL: first.wall_s,
        FIRST_MEMORY: first.most_mb,
        SQL_WALL: samples.wall_s,
        SEARCH: sum(searched_s(short) for _ in range(SAMPLE)) / SAMPLE * count,
        INDEX_CPU: index_s * 3600 / LONG_S,
        INDEX_SHARE: share,
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--recordings", type=int, default=10_000)
    parser.add_argument("--folder", type=Path, help="for the indexes, kept for the next run")
    given = parser.parse_args()
    rounds = []
    with tempfile.TemporaryDirectory(prefix="robotctl-fleet-") as scratch:
        short = record_drive(Path(scratch, "short"), SHORT_S, rate_hz=RATE_HZ, moving=True)
        long = record_drive(Path(scratch, "long"), LONG_S, rate_hz=RATE_HZ, moving=True)
        many = given.folder or Path(scratch, "many")
        if not many.exists():
            make_many(many, short, given.recordings)
        for number in range(1, given.rounds + 1):
            load = os.getloadavg()[0]
            print(f"round {number} of {given.rounds}, load {load:.1f}", file=sys.stderr)
            rounds.append(one_round(many, given.recordings, short, long))
    lines, missed = table(FIGURES, rounds)
    print(f"{given.recordings} recordings\n\n| figure | to reach | measured | |\n|---|---|---|---|")
    print(*lines, sep="\n")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
