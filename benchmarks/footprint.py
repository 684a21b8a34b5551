"""CPU and memory of the daemon against the classic arrangement, one process a role.

    python benchmarks/footprint.py                                    about 8 minutes
    python benchmarks/footprint.py --rates 50 --rounds 3 --seconds 4

The daemon runs with control, simulated robot and recorder, and drives a square. The classic
arrangement is the usual one: four processes of plain rclpy in `benchmarks/classic` (velocity
publisher, odometry subscriber, mode service with status, simulated robot of the same physics), and
a recorder. It has no journal, no closed loop and no socket.

Each arrangement is measured alone, in turn, so that a noisy machine is noisy for both; ratios are
computed within a round. Shown are medians over the rounds, and the lowest and highest in brackets.
rosbag2's C++ recorder is not available on this platform: measured elsewhere, it needs 16 % of the
CPU of the whole. So the daemon is compared with the four processes and a computed recorder of that
share. CPU is user and system time of all threads (/proc/PID/stat), PSS the memory at the end
(/proc/PID/smaps_rollup). Messages are those of /cmd_vel and /odom that were recorded. Wake-ups are
voluntary context switches of all threads (/proc/PID/task/TID/status).
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader
from recording.figures import Figure, Round, table

CLASSIC = Path(__file__).parent / "classic"
ROLES = ("mode_service", "velocity_publisher", "odom_subscriber", "simulated_robot", "recorder")
CPP_RECORDER_SHARE = 0.16
CPU_TARGETS = {50.0: 0.30, 100.0: 0.27}
WAKE_UP_TARGETS = {50.0: 110.0}
PSS_TARGET = 0.46
CPU_RATIO = "CPU to four processes and a C++ recorder (computed)"
FREE_DOMAINS = (101, 230)
END_TIMEOUT_S = 20.0
MOVING = 1


@dataclass(frozen=True)
class Usage:
    """The sum over an arrangement's processes: CPU and PSS in % and MB, and rates per second.

    `recorder_cpu` is the CPU of the last process: for the classic arrangement, its recorder.
    """

    cpu: float
    recorder_cpu: float
    pss: float
    messages_per_second: float
    wake_ups_per_second: float

    def cpu_with_cpp_recorder(self) -> float:
        """Return the CPU [%] of the classic arrangement if a C++ recorder replaced its own."""
        return (self.cpu - self.recorder_cpu) / (1.0 - CPP_RECORDER_SHARE)


def environment(folder: Path, domain: int) -> dict[str, str]:
    """Return the environment of one run: its own ROS domain, sockets and logs in `folder`."""
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "XDG_RUNTIME_DIR": str(folder),
        "XDG_STATE_HOME": str(folder),
    }


@contextmanager
def daemon(rate_hz: float, folder: Path, domain: int, settings: str = "") -> Iterator[list[int]]:
    """Run a daemon that drives a square, with `settings` added to its file; yield its pid."""
    config = folder / "config.yaml"
    rates = f"rate_hz: {rate_hz}\nsim.odometry_rate_hz: {rate_hz}\n"
    config.write_text(f"{rates}recording.index: false\n{settings}")
    read_end, write_end = os.pipe()
    command = [sys.executable, "-P", "-m", "robotctl.daemon", "--config", str(config), "--sim"]
    command += ["--recordings", str(folder), "--drive", "square", "--ready-fd", str(write_end)]
    with (folder / "log").open("w") as log, ending() as processes:
        processes.append(
            subprocess.Popen(
                command, env=environment(folder, domain), pass_fds=[write_end], stderr=log
            )
        )
        os.close(write_end)
        with os.fdopen(read_end) as told:
            said = json.loads(told.readline() or "{}")
        if not said.get("ready"):
            raise SystemExit(f"the daemon did not start: {said.get('error', 'it said nothing')}")
        yield [processes[0].pid]


@contextmanager
def classic(rate_hz: float, folder: Path, domain: int) -> Iterator[list[int]]:
    """Run the classic processes in MOVING; yield their pids, the recorder's last."""
    arguments = {
        "mode_service": ["--ros-args", "-p", f"mode:={MOVING}"],
        "velocity_publisher": ["--ros-args", "-p", f"rate_hz:={rate_hz}"],
        "simulated_robot": ["--ros-args", "-p", f"rate_hz:={rate_hz}"],
        "recorder": [str(folder / "classic.mcap")],
    }
    with (folder / "log").open("w") as log, ending() as processes:
        for role in ROLES:
            command = [sys.executable, str(CLASSIC / f"{role}.py"), *arguments.get(role, [])]
            processes.append(subprocess.Popen(command, env=environment(folder, domain), stderr=log))
        yield [process.pid for process in processes]
        for process, role in zip(processes, ROLES, strict=True):
            if process.poll() is not None:
                raise SystemExit(f"{role} ended early: {(folder / 'log').read_text()}")


@contextmanager
def ending() -> Iterator[list[subprocess.Popen[bytes]]]:
    """Yield a list for processes; at the end of the block, terminate them, or else kill them."""
    processes: list[subprocess.Popen[bytes]] = []
    try:
        yield processes
    finally:
        for process in processes:
            process.send_signal(signal.SIGTERM)
        for process in processes:
            try:
                process.wait(END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def cpu_s(pid: int) -> float:
    """Return the user and system time of a process so far [s]."""
    after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(after_name[11]) + int(after_name[12])) / os.sysconf("SC_CLK_TCK")


def wake_ups(pid: int) -> int:
    """Return how often the threads of a process have gone to sleep so far."""
    total = 0
    for status in Path(f"/proc/{pid}/task").glob("*/status"):
        with suppress(FileNotFoundError):  # the thread has just ended
            total += int(status.read_text().split("\nvoluntary_ctxt_switches:")[1].split()[0])
    return total


def pss_mb(pid: int) -> float:
    """Return the PSS of a process [MB]: each shared page is divided among its processes."""
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "Pss":
            return int(value.split()[0]) * 1024 / 1e6
    raise SystemExit(f"/proc/{pid}/smaps_rollup has no Pss: is this Linux?")


ARRANGEMENTS = {"daemon": daemon, "classic": classic}


def measure(name: str, rate_hz: float, options: argparse.Namespace, domain: int) -> Usage:
    """Run an arrangement, and return what it used in `options.seconds` after a warm-up."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        with ARRANGEMENTS[name](rate_hz, folder, domain) as pids:
            time.sleep(options.warm_up)
            woken = -sum(map(wake_ups, pids))
            before, begun = [cpu_s(pid) for pid in pids], time.monotonic()
            time.sleep(options.seconds)
            after, took_s = [cpu_s(pid) for pid in pids], time.monotonic() - begun
            woken += sum(map(wake_ups, pids))
            pss = sum(map(pss_mb, pids))
        shares = [
            100.0 * (late - early) / took_s for early, late in zip(before, after, strict=True)
        ]
        recorded = recorded_per_second(folder)
        return Usage(sum(shares), shares[-1], pss, recorded, woken / took_s)


def recorded_per_second(folder: Path) -> float:
    """Return the sum of the recorded rates of /cmd_vel and /odom [messages/s]."""
    (path,) = (each for each in folder.rglob("*.mcap") if each.parent.name != "clips")
    times: dict[str, list[int]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=["/cmd_vel", "/odom"]):
            times.setdefault(channel.topic, []).append(message.log_time)
    if len(times) < 2 or min(map(len, times.values())) < 2:
        raise SystemExit(f"not both /cmd_vel and /odom were recorded, but {sorted(times)}")
    return sum(1e9 * (len(each) - 1) / (max(each) - min(each)) for each in times.values())


def figures(rate_hz: float) -> tuple[Figure, ...]:
    """Return the lines of the table for a rate, with their limits."""
    return (
        Figure(CPU_RATIO, CPU_TARGETS.get(rate_hz), digits=".3f"),
        Figure("PSS, daemon to classic", PSS_TARGET, digits=".3f"),
        Figure("wake-ups a second, daemon", WAKE_UP_TARGETS.get(rate_hz), digits=".0f"),
        *(Figure(f"CPU, {name} [%]") for name in ARRANGEMENTS),
        Figure("CPU, of classic the recorder [%]"),
        Figure("CPU, daemon to classic", digits=".3f"),
        *(Figure(f"PSS, {name} [MB]", digits=".1f") for name in ARRANGEMENTS),
        Figure("wake-ups a second, classic", digits=".0f"),
        *(Figure(f"messages recorded a second, {name}", digits=".1f") for name in ARRANGEMENTS),
    )


def values(used: dict[str, Usage]) -> Round:
    """Return the figures of one round by name."""
    ours, classic_used = used["daemon"], used["classic"]
    told = {
        CPU_RATIO: ours.cpu / classic_used.cpu_with_cpp_recorder(),
        "PSS, daemon to classic": ours.pss / classic_used.pss,
        "CPU, of classic the recorder [%]": classic_used.recorder_cpu,
        "CPU, daemon to classic": ours.cpu / classic_used.cpu,
    }
    for name, each in used.items():
        told[f"CPU, {name} [%]"] = each.cpu
        told[f"PSS, {name} [MB]"] = each.pss
        told[f"wake-ups a second, {name}"] = each.wake_ups_per_second
        told[f"messages recorded a second, {name}"] = each.messages_per_second
    return told


def main() -> int:
    """Print a table for each rate; return 1 if a figure is missed, else 0."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rates", default="50,100", help="in Hz")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--warm-up", type=float, default=4.0, help="seconds before it")
    options = parser.parse_args()
    first_domain, last_domain = FREE_DOMAINS
    domain = first_domain + os.getpid() % (last_domain - first_domain)
    missed = 0
    for rate_hz in map(float, options.rates.split(",")):
        rounds = []
        for number in range(options.rounds):
            results = {}
            for name in ARRANGEMENTS:
                results[name] = measure(name, rate_hz, options, domain)
                used = results[name]
                print(
                    f"  {rate_hz:g} Hz, round {number + 1}, {name}: "
                    f"{used.cpu:.2f} %, {used.pss:.1f} MB",
                    file=sys.stderr,
                )
            rounds.append(values(results))
        lines, missed_here = table(figures(rate_hz), rounds)
        missed += missed_here
        print(f"| at {rate_hz:g} Hz | to reach | measured | |\n|---|---|---|---|", *lines, sep="\n")
    print(f"load average {os.getloadavg()[0]:.1f}")
    print(f"{missed} missed." if missed else "All reached.")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
