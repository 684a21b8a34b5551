"""CPU and memory of the daemon beside one process a role: ours, and the classic arrangement.

    python benchmarks/footprint.py                                    about 8 minutes
    python benchmarks/footprint.py --rates 50 --rounds 3 --seconds 4

The daemon runs with control, simulated robot and recorder, and drives a square. The classic
arrangement does as much of it as is usual: four processes of plain rclpy in `benchmarks/classic`
(velocity publisher, odometry subscriber, mode service with status, simulated robot of the same
physics), and a recorder. It does without journal, closed loop and socket.

Between the two stands one process a role on the AsyncioExecutor: simulated robot, gate
(`velocity_publisher`) and owner (`mode_service`, with kernel, journal, recorder and socket).

Each is measured with the other absent, in turn, so that a noisy machine is noisy for both; ratios
are taken within a round. Shown are medians over the rounds, and the lowest and highest in
brackets. CPU is user and system time of all threads (/proc/PID/stat), PSS what is in memory at the
end (/proc/PID/smaps_rollup). Messages are those of /cmd_vel and /odom that were recorded. Wake-ups
are voluntary context switches of all threads (/proc/PID/task/TID/status).
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader

CLASSIC = Path(__file__).parent / "classic"
ROLES = ("mode_service", "velocity_publisher", "odom_subscriber", "simulated_robot", "recorder")
RECORDER_NOTE = """\
The classic recorder is plain rclpy with the mcap package's writer, because rosbag2 is not available
on this platform. Measured elsewhere, with rosbag2's C++ recorder, the classic arrangement takes
13.8 % CPU at 50 Hz, 21.9 % at 100 Hz, and 190 MB."""

CPU_TARGET, PSS_TARGET = 1 / 3, 0.45
FREE_DOMAINS = (101, 230)
READY_TIMEOUT_S = 60.0
END_TIMEOUT_S = 20.0
MOVING = 1


@dataclass(frozen=True)
class Usage:
    """What processes used together: CPU and its part for recording [%], PSS [MB], what they did."""

    cpu: float
    recorder_cpu: float
    pss: float
    messages_per_second: float
    wake_ups_per_second: float


def environment(folder: Path, domain: int) -> dict[str, str]:
    """One of its own for each run: nobody else is heard, nothing of the user's is touched."""
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "XDG_RUNTIME_DIR": str(folder),
        "XDG_STATE_HOME": str(folder),
    }


@contextmanager
def daemon(rate_hz: float, folder: Path, domain: int, settings: str = "") -> Iterator[list[int]]:
    """Start the daemon, moving, with further lines of configuration; yields its pid."""
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
def roles(rate_hz: float, folder: Path, domain: int) -> Iterator[list[int]]:
    """Start our roles, a process each, moving; yields their pids."""
    config, around = folder / "config.yaml", environment(folder, domain)
    config.write_text(f"rate_hz: {rate_hz}\nsim.odometry_rate_hz: {rate_hz}\n")
    owned = {"config": config, "recordings": folder / "recordings", "standalone": "false"}
    given = [word for name, value in owned.items() for word in ("-p", f"{name}:={value}")]
    commands = (
        [command_named("mode_service"), "--ros-args", *given],
        [command_named("velocity_publisher"), "--ros-args", "-p", "sweep:=false"],
        [command_named("robotctl"), "sim", "--config", str(config)],
    )
    with (folder / "log").open("w") as log, ending() as processes:
        for command in commands:
            processes.append(subprocess.Popen(command, env=around, stdout=log, stderr=log))
        until = time.monotonic() + READY_TIMEOUT_S
        while subprocess.run(
            [command_named("robotctl"), "set-mode", "moving"],
            env=around,
            capture_output=True,
            check=False,
        ).returncode:
            if time.monotonic() > until:
                raise SystemExit(f"our roles do not move: {(folder / 'log').read_text()}")
            time.sleep(0.2)
        yield [process.pid for process in processes]


def command_named(name: str) -> str:
    """The path of a command of this environment."""
    return str(Path(sys.executable).with_name(name))


@contextmanager
def classic(rate_hz: float, folder: Path, domain: int) -> Iterator[list[int]]:
    """Start the roles, moving; yields their pids, the recorder's last."""
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
    """A list of processes that end with the block: asked first, killed where they do not hear."""
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
    """User and system time of a process so far [s]."""
    after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(after_name[11]) + int(after_name[12])) / os.sysconf("SC_CLK_TCK")


def wake_ups(pid: int) -> int:
    """How often the threads of a process have gone to sleep so far."""
    total = 0
    for status in Path(f"/proc/{pid}/task").glob("*/status"):
        with suppress(FileNotFoundError):  # the thread has just ended
            total += int(status.read_text().split("\nvoluntary_ctxt_switches:")[1].split()[0])
    return total


def pss_mb(pid: int) -> float:
    """Memory of a process, shared pages divided among those who share them [MB]."""
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "Pss":
            return int(value.split()[0]) * 1024 / 1e6
    raise SystemExit(f"/proc/{pid}/smaps_rollup has no Pss: is this Linux?")


ARRANGEMENTS = {"daemon": daemon, "roles": roles, "classic": classic}


def measure(name: str, rate_hz: float, options: argparse.Namespace, domain: int) -> Usage:
    """Start an arrangement, let it settle, watch it for a while, end it."""
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
    """Messages of command and odometry in the recording, while both were there."""
    (path,) = (each for each in folder.rglob("*.mcap") if each.parent.name != "clips")
    times: dict[str, list[int]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=["/cmd_vel", "/odom"]):
            times.setdefault(channel.topic, []).append(message.log_time)
    if len(times) < 2 or min(map(len, times.values())) < 2:
        raise SystemExit(f"not both /cmd_vel and /odom were recorded, but {sorted(times)}")
    return sum(1e9 * (len(each) - 1) / (max(each) - min(each)) for each in times.values())


def spread(values: Sequence[float], digits: str) -> str:
    """Median [lowest .. highest]."""
    low, middle, high = min(values), statistics.median(values), max(values)
    return f"{middle:{digits}} [{low:{digits}} .. {high:{digits}}]"


def show(rate_hz: float, rounds: list[dict[str, Usage]]) -> bool:
    """Print the figures of one rate; returns whether both targets were reached."""
    print(f"\n{rate_hz:g} Hz")
    for name in ARRANGEMENTS:
        used = [results[name] for results in rounds]
        line = f"  {name:8} CPU {spread([each.cpu for each in used], '5.2f')} %"
        line += f"   PSS {spread([each.pss for each in used], '5.1f')} MB"
        line += f"   {statistics.median(each.messages_per_second for each in used):.1f} messages/s"
        line += f"   {statistics.median(each.wake_ups_per_second for each in used):.0f} wake-ups/s"
        print(line)
    recorder = statistics.median(results["classic"].recorder_cpu for results in rounds)
    print(f"  of the classic CPU the recorder takes {recorder:.2f} %")
    reached = True
    for what, target in (("cpu", CPU_TARGET), ("pss", PSS_TARGET)):
        ratios = [getattr(each["daemon"], what) / getattr(each["classic"], what) for each in rounds]
        ok = statistics.median(ratios) <= target
        reached = reached and ok
        verdict = "reached" if ok else "NOT REACHED"
        print(
            f"  {what.upper()} ratio {spread(ratios, '.3f')}, to be at most {target:.3f}: {verdict}"
        )
    for what in ("cpu", "pss"):
        ratios = [getattr(each["roles"], what) / getattr(each["classic"], what) for each in rounds]
        print(f"  our roles beside the classic ones, {what.upper()} ratio {spread(ratios, '.3f')}")
    return reached


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rates", default="50,100", help="in Hz")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--warm-up", type=float, default=4.0, help="seconds before it")
    options = parser.parse_args()
    print(RECORDER_NOTE)
    first_domain, last_domain = FREE_DOMAINS
    domain = first_domain + os.getpid() % (last_domain - first_domain)
    reached = True
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
            rounds.append(results)
        reached = show(rate_hz, rounds) and reached
    return 0 if reached else 1


if __name__ == "__main__":
    sys.exit(main())
