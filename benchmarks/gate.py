"""`robotctl gate`: recordings a second and core, in one process, in processes and on Dask.

    python benchmarks/gate.py                        5 rounds, some minutes
    python benchmarks/gate.py --rounds 1 --recordings 100

It needs `pip install 'robotctl[cluster]'`. A simulated drive of a minute at 100 Hz is recorded
once, and stands there under many names, which are part of the hash. In a round a process alone, a
process per core, and a scheduler with three workers over TCP judge as many other names each. CPU
time is that of all processes taking part: with the starts of the processes per core, without those
of scheduler and workers, which go on. Then the gate runs again, and finds everything judged.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import active_children
from pathlib import Path

import psutil
from recording.figures import Figure, Round, table
from recording.heard_drive import record_drive

from robotctl.fleet.baseline import Baseline
from robotctl.fleet.cluster import Cluster
from robotctl.fleet.gate import judge_all
from robotctl.fleet.judging import Engine, Judging, judge_here
from robotctl.fleet.result_store import ResultStore
from robotctl.fleet.software import software_hash
from robotctl.rerun.check_report import Verdict

RATE_HZ = 100.0
SECONDS = 60.0
WORKERS = 3
MONTH_H = 240.0

QUIET = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "false"}
"""Without the profile that each worker takes of itself, as docs/fleet.md advises."""

ALONE = "one process, recordings/s and core"
PROCESSES = "a process per core, recordings/s and core"
DASK = "Dask, three workers over TCP, recordings/s and core"
SHARE = "Dask / one process"
AGAIN = "again, all judged before: recordings/s and core"
MONTH = "a robot-month of 240 h on Dask [core-hours]"

FIGURES = (
    Figure(ALONE, digits=".1f"),
    Figure(PROCESSES, digits=".1f"),
    Figure(DASK, digits=".1f"),
    Figure(SHARE, 0.85, at_least=True),
    Figure(AGAIN, digits=".0f"),
    Figure(MONTH, digits=".2f"),
)


class Names:
    """A recording under many names, none of them used twice."""

    def __init__(self, folder: Path) -> None:
        (folder / "made").mkdir(parents=True)
        made = record_drive(folder / "made/run", SECONDS, rate_hz=RATE_HZ, moving=True)
        (self._file,) = made.glob("*.mcap")
        self._folder = folder
        self._used = 0

    def take(self, count: int) -> list[Path]:
        """Return the recording under names that no gate has seen."""
        taken = []
        for number in range(self._used, self._used + count):
            folder = self._folder / f"run_{number:06}"
            folder.mkdir()
            (folder / f"{folder.name}_0.mcap").hardlink_to(self._file)
            taken.append(folder)
        self._used += count
        return taken


@contextmanager
def dask_cluster(folder: Path) -> Iterator[tuple[str, Callable[[], float]]]:
    """Yield the address of a scheduler with workers, and what tells the CPU time of all."""
    address_file = folder / "scheduler.json"

    def start(program: str, *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{program}", *arguments],
            env=os.environ | QUIET,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    place = ("--scheduler-file", str(address_file), "--no-dashboard", "--dashboard-address", ":0")
    processes = [start("scheduler", "--host", "127.0.0.1", "--port", "0", *place)]
    one_core = ("--no-nanny", "--nthreads", "1", "--death-timeout", "60")
    scratch = ("--local-directory", str(folder))
    processes += [start("worker", *one_core, *scratch, *place) for _ in range(WORKERS)]
    try:
        from distributed import Client

        with Client(scheduler_file=str(address_file), timeout=60) as client:
            client.wait_for_workers(WORKERS, timeout=60)
            address = str(client.scheduler_info()["address"])

        def cpu_s() -> float:
            times = [psutil.Process(each.pid).cpu_times() for each in processes]
            return float(sum(each.user + each.system for each in times))

        yield address, cpu_s
    finally:
        for process in processes:
            process.kill()
            process.wait()


def own_cpu_s() -> float:
    """CPU time of this process and of those that it has started, when they have ended [s]."""
    while active_children():  # which also collects those that have ended
        time.sleep(0.01)
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def judged(recordings: Sequence[Path], store: ResultStore, engine: Engine) -> None:
    """Run the gate; every recording must be the same."""
    report = judge_all(recordings, store, {}, Baseline(), engine)
    assert report.counts()[Verdict.SAME] == len(recordings), report.counts()


def one_round(
    names: Names, count: int, store: ResultStore, cluster: Engine, cluster_s: Callable[[], float]
) -> Round:
    """Every figure once."""
    judging = Judging({}, store, software_hash())
    begin_s = own_cpu_s()
    for path in names.take(count):
        judging.judged(path)
    alone_s = own_cpu_s() - begin_s

    begin_s = own_cpu_s()
    judged(names.take(count), store, judge_here)
    processes_s = own_cpu_s() - begin_s

    recordings = names.take(count)
    begin_s = own_cpu_s() + cluster_s()
    judged(recordings, store, cluster)
    dask_s = own_cpu_s() + cluster_s() - begin_s

    begin_s = own_cpu_s()
    judged(recordings, store, judge_here)
    again_s = own_cpu_s() - begin_s
    return {
        ALONE: count / alone_s,
        PROCESSES: count / processes_s,
        DASK: count / dask_s,
        SHARE: alone_s / dask_s,
        AGAIN: count / again_s,
        MONTH: dask_s / count * MONTH_H / SECONDS,  # seconds of a core for SECONDS, hours for hours
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--recordings", type=int, default=60, help="for each in a round")
    arguments = parser.parse_args()
    rounds = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        names, store = Names(folder / "recordings"), ResultStore(folder / "results")
        with dask_cluster(folder) as (address, cluster_s):
            cluster = Cluster(address, folder).judge
            judged(names.take(2 * WORKERS), store, cluster)  # imports of the workers
            for number in range(1, arguments.rounds + 1):
                load = os.getloadavg()[0]
                print(f"round {number} of {arguments.rounds}, load {load:.1f}", file=sys.stderr)
                rounds.append(one_round(names, arguments.recordings, store, cluster, cluster_s))
    lines, missed = table(FIGURES, rounds)
    print("| figure | to reach | measured | |\n|---|---|---|---|")
    print(*lines, sep="\n")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
