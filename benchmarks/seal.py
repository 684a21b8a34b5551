"""What the seal of a recording costs the daemon: CPU, bytes, memory.

    python benchmarks/seal.py                          5 rounds, two minutes
    python benchmarks/seal.py --rounds 3 --seconds 8

The daemon drives a square at 50 Hz and records, in turn with and without `recording.seal`. CPU is
that of all threads, and of the recorder's thread, in which the seal is made (/proc/PID/task/*/
schedstat); PSS is what is in memory at the end. The bytes of the seal are those of its records.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

from footprint import FREE_DOMAINS, daemon, pss_mb
from recording.figures import Figure, Round, table

from robotctl.recording.format.seal_records import LINK_OPCODE, OPENING_OPCODE
from robotctl.recording.read.mcap_input import RECORD_HEAD
from robotctl.recording.read.verified import RecordingProof, verify_recording

RATE_HZ = 50.0
RECORDER_NICE = 5
"""The nice value of the recorder's thread, and of no other."""

FIGURES = (
    Figure("CPU with the seal [% of a core]"),
    Figure("CPU without it [% of a core]"),
    Figure("CPU of the recorder's thread with it [% of a core]", digits=".3f"),
    Figure("CPU of the recorder's thread without it [% of a core]", digits=".3f"),
    Figure("CPU of the seal in that thread [% of a core]", 0.5, digits=".3f"),
    Figure("bytes of the seal [% of the file]", 0.5, digits=".3f"),
    Figure("bytes written with it / without it, per second", digits=".3f"),
    Figure("PSS with it [MB]", digits=".1f"),
    Figure("PSS without it [MB]", digits=".1f"),
    Figure("PSS of the seal [MB]", digits=".1f"),
)


def cpu_s(pid: int) -> tuple[float, float]:
    """CPU time so far of all threads, and of the recorder's thread [s]."""
    total = recorder = 0.0
    for task in Path(f"/proc/{pid}/task").iterdir():
        taken_s = int((task / "schedstat").read_text().split()[0]) / 1e9
        total += taken_s
        after_name = (task / "stat").read_text().rpartition(")")[2].split()
        if int(after_name[16]) == RECORDER_NICE:
            recorder += taken_s
    return total, recorder


def measure(options: argparse.Namespace, domain: int, *, sealed: bool) -> dict[str, float]:
    """Start the daemon, let it settle, watch it for a while, end it, and read what it wrote."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        settings = f"recording.seal: {str(sealed).lower()}\n"
        with daemon(RATE_HZ, folder, domain, settings) as (pid,):
            time.sleep(options.warm_up)
            before, begun = cpu_s(pid), time.monotonic()
            time.sleep(options.seconds)
            after, took_s = cpu_s(pid), time.monotonic() - begun
            pss = pss_mb(pid)
        (path,) = (each for each in folder.rglob("*.mcap") if each.parent.name != "clips")
        found = verify_recording(path.parent)
        assert found.proof is (RecordingProof.SEALED if sealed else RecordingProof.WHOLE), found
        (whole,) = found.whole.files
        seal_bytes = sum(
            RECORD_HEAD.size + length
            for opcode, _, length in whole.data.private
            if opcode in (OPENING_OPCODE, LINK_OPCODE)
        )
        seal_bytes += sum(
            RECORD_HEAD.size + len(content) for _, content in whole.data.private_in_summary
        )
        recorded_s = (whole.data.end_ns - whole.data.start_ns) / 1e9
        return {
            "cpu": 100 * (after[0] - before[0]) / took_s,
            "recorder": 100 * (after[1] - before[1]) / took_s,
            "pss": pss,
            "seal": 100 * seal_bytes / path.stat().st_size,
            "rate": path.stat().st_size / recorded_s,
        }


def one_round(options: argparse.Namespace, domain: int, *, sealed_first: bool) -> Round:
    """Measure both, one after the other."""
    found = {
        each: measure(options, domain, sealed=each) for each in (sealed_first, not sealed_first)
    }
    with_it, without = found[True], found[False]
    return {
        "CPU with the seal [% of a core]": with_it["cpu"],
        "CPU without it [% of a core]": without["cpu"],
        "CPU of the recorder's thread with it [% of a core]": with_it["recorder"],
        "CPU of the recorder's thread without it [% of a core]": without["recorder"],
        "CPU of the seal in that thread [% of a core]": with_it["recorder"] - without["recorder"],
        "bytes of the seal [% of the file]": with_it["seal"],
        "bytes written with it / without it, per second": with_it["rate"] / without["rate"],
        "PSS with it [MB]": with_it["pss"],
        "PSS without it [MB]": without["pss"],
        "PSS of the seal [MB]": with_it["pss"] - without["pss"],
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--warm-up", type=float, default=4.0, help="seconds before it")
    options = parser.parse_args()
    first_domain, last_domain = FREE_DOMAINS
    domain = first_domain + os.getpid() % (last_domain - first_domain)
    rounds = []
    for number in range(1, options.rounds + 1):
        print(f"round {number} of {options.rounds}, load {os.getloadavg()[0]:.1f}", file=sys.stderr)
        rounds.append(one_round(options, domain, sealed_first=bool(number % 2)))
    lines, missed = table(FIGURES, rounds)
    print("| figure | to reach | measured | |\n|---|---|---|---|")
    print(*lines, sep="\n")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
