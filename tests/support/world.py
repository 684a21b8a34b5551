"""An isolated environment (a world) for tests with the real daemon.

A world has a folder, a ROS domain, and environment variables that all of its processes inherit.
The variables identify the processes that are left at its end, also after a failed test.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from shutil import rmtree
from typing import Any

import pytest
from ament_index_python.packages import get_package_prefix

from robotctl.base.domains import reserved_domain
from robotctl.base.errors import UnreadableFile
from robotctl.base.processes import pidfd_of, readable_within
from robotctl.check.report import Report, Verdict
from robotctl.check.run import check_recording
from robotctl.cli import app
from robotctl.ipc.client import call
from robotctl.ipc.method_names import STATUS
from robotctl.recording import Recording, read_journal
from robotctl.recording.format.journal import JournalEntry, decode
from robotctl.recording.format.names import INFO_RECORD
from robotctl.recording.keep.listing import CLIPS_FOLDER
from tests.support.lines import Ran, Told, peer_command
from tests.support.waiting import DEADLINE_S, until


def contradictions(folder: Path, *, may_lack: bool, killed: bool) -> list[str]:
    """Check the recordings and clips below a folder; return a line for each wrong verdict.

    Any recording may be incomplete with `may_lack`; a clip always; and if `killed`, a recording
    whose daemon was killed before its first journal entry was on the disk.
    """
    recordings = {
        path if path.parent.name == CLIPS_FOLDER else path.parent for path in folder.rglob("*.mcap")
    }
    return [
        f"recording: {report.as_object()}"
        for report in map(check_recording, sorted(recordings))
        if report.verdict in (Verdict.DIVERGED, Verdict.BROKEN)
        or (
            report.verdict is Verdict.INCOMPLETE
            and not may_lack
            and (report.events or not killed)
            and _decides(report)
        )
    ]


def _decides(report: Report) -> bool:
    """Return whether a daemon that controls a robot made the recording: its info names topics.

    False for a clip, which may be incomplete where it was cut.
    """
    if report.path.parent.name == CLIPS_FOLDER:
        return False
    try:
        with Recording(report.path) as recording:
            return "topic.robot_status" in recording.info().metadata.get(INFO_RECORD, {})
    except UnreadableFile:
        return False


def installed(name: str) -> str:
    """Return the path of a command, as pip installs it, or else as colcon does for `ros2 run`."""
    by_pip = Path(sys.executable).with_name(name)
    if by_pip.exists():
        return str(by_pip)
    return str(Path(get_package_prefix("robot_controller"), "lib/robot_controller", name))


ROBOTCTL = installed("robotctl")
SHARED_MEMORY = Path("/dev/shm")

PATIENT = """\
max_tick_gap_s: 5.0
odometry.timeout_s: 10.0
battery.timeout_s: 60.0
recording.index: false
recording.clip_before_s: 0.0
"""
"""Time limits for a slow machine, without indexes and clips, which need further processes."""

NO_INDEX = ("--ros-args", "-p", "recording.index:=false")
"""Arguments that a `start` with another configuration gets, so that it makes no index."""

INDEXING = "robotctl.collection.indexing:index_job"


class Peer(Told):
    """Commands a second process with plain rclpy (tests.support.ros_peer)."""

    def __init__(self, world: World) -> None:
        command = (*world.inside, *peer_command("tests.support.ros_peer"))
        super().__init__(command, world.environment)


class World:
    """A folder, a ROS domain, and the processes that run there."""

    def __init__(self, folder: Path, domain_id: int) -> None:
        self.folder = folder
        self.domain_id = domain_id
        self.recordings = folder / "recordings"
        self.patient = folder / "patient.yaml"
        """A configuration for all tests that do not test the time limits themselves."""

        self.patient.write_text(PATIENT)
        self.environment = {
            **os.environ,
            "XDG_RUNTIME_DIR": str(folder / "run"),
            "XDG_STATE_HOME": str(folder / "state"),
            "ROS_DOMAIN_ID": str(domain_id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "COLUMNS": "80",
            "PYTHONUNBUFFERED": "1",
        }
        self.inside: tuple[str, ...] = ()
        """The words that begin a command line to run it on another host (`Host.inside`)."""

        self.may_lack = ""
        """Why recordings of this world may be incomplete, "" if they must not."""

        self._mark = f"XDG_RUNTIME_DIR={folder / 'run'}\0".encode()
        self._killed = False
        self._memory_before = set(self.shared_memory())  # of other killed processes in the domain
        self._spawned: list[subprocess.Popen[str]] = []
        (folder / "run").mkdir(mode=0o700)

    def source_another_ros(self) -> None:
        """Run later command lines as from a shell that has sourced a broken ROS."""
        ros = self.folder / "humble"
        packages = ros / "lib" / "python3.10" / "site-packages"
        (packages / "rclpy").mkdir(parents=True)
        (packages / "rclpy" / "__init__.py").write_text("raise ImportError('the foreign one')\n")
        (ros / "lib" / "librcl.so").write_bytes(b"no library")
        (ros / "share" / "rclpy").mkdir(parents=True)
        paths = {"PYTHONPATH": packages, "LD_LIBRARY_PATH": ros / "lib", "AMENT_PREFIX_PATH": ros}
        for variable, path in paths.items():
            known = self.environment.get(variable)
            self.environment[variable] = f"{path}:{known}" if known else str(path)
        self.environment["ROS_DISTRO"] = "humble"

    def spawn(self, *arguments: str, settings: str = "", **options: Any) -> subprocess.Popen[str]:
        """Start a command line; `start` without a configuration gets `settings`, or `PATIENT`."""
        if settings:
            config = self.folder / "robot.yaml"
            config.write_text(settings)
            arguments = (*arguments, "--config", str(config))
        if arguments[0] == "start" and "--config" not in arguments:
            arguments = (*arguments, "--config", str(self.patient))
        elif arguments[0] == "start" and "--ros-args" not in arguments:
            arguments = (*arguments, *NO_INDEX)
        process = subprocess.Popen(
            [*self.inside, ROBOTCTL, *arguments],
            text=True,
            stdin=subprocess.DEVNULL,
            **{
                "stdout": subprocess.PIPE,
                "stderr": subprocess.PIPE,
                "cwd": self.folder,
                "env": self.environment,
                **options,
            },
        )
        self._spawned.append(process)
        return process

    def robotctl(self, *arguments: str, settings: str = "") -> Ran:
        """Run a command line to its end."""
        process = self.spawn(*arguments, settings=settings)
        out, err = process.communicate(timeout=2 * DEADLINE_S)
        assert "Traceback" not in err
        return Ran(process.returncode, out, err)

    def here(self, *arguments: str) -> Ran:
        """Run a command line in this process, which is faster for queries and refused requests."""
        out, err = StringIO(), StringIO()
        with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
            self.enter(patch)
            patch.chdir(self.folder)
            exit_code = app.run(list(arguments))
        return Ran(exit_code, out.getvalue(), err.getvalue())

    def answer_here(self, *arguments: str) -> Any:
        """Run a command line that must succeed in this process; return its `--json` output."""
        ran = self.here(*arguments, "--json")
        assert ran.exit_code == 0, (arguments, ran, self.log())
        return json.loads(ran.out)

    def ok(self, *arguments: str, settings: str = "") -> str:
        """Run a command line that must succeed; return its output."""
        ran = self.robotctl(*arguments, settings=settings)
        assert ran.exit_code == 0, (arguments, ran, self.log())
        return ran.out

    def answer(self, *arguments: str) -> Any:
        """Run a command line that must succeed; return its `--json` output."""
        return json.loads(self.ok(*arguments, "--json"))

    def peer(self, role: str) -> Told:
        """Start a process of tests.support.role_peers."""
        return Told(peer_command("tests.support.role_peers", role), self.environment)

    @property
    def recording(self) -> Path:
        """The only recording of this world."""
        (folder,) = self.recordings.iterdir()
        return folder

    def status(self, robot: str = "robot") -> Any:
        """Return the daemon's status from its socket, without a process: tests poll it."""
        with pytest.MonkeyPatch.context() as patch:
            self.enter(patch)
            return call(robot, STATUS)

    def enter(self, patch: pytest.MonkeyPatch) -> None:
        """Set the variables of this world in this process, until the patch is undone."""
        for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "ROS_DOMAIN_ID", "COLUMNS"):
            patch.setenv(name, self.environment[name])

    def log(self, robot: str = "robot") -> str:
        """Return the daemon's log."""
        path = self.folder / "state" / "robotctl" / robot / "daemon.log"
        return path.read_text() if path.exists() else ""

    def sockets(self) -> list[Path]:
        """Return the existing control sockets."""
        return list((self.folder / "run").glob("robotctl/*.sock"))

    def processes(self) -> dict[int, str]:
        """Return the processes of this world: pid -> command line."""
        found = {}
        for entry in Path("/proc").iterdir():
            with suppress(OSError):
                if entry.name.isdecimal() and self._mark in (entry / "environ").read_bytes():
                    found[int(entry.name)] = (entry / "cmdline").read_text().replace("\0", " ")
        return found

    def kill(self, pid: int, number: int = signal.SIGKILL) -> None:
        """Kill a process of this world, and remove the shared memory that it owned.

        It has also mapped memory of other processes, which would lose messages without it.
        """
        self._killed = True
        own = set()
        for each in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):  # closed meanwhile
                own.add(os.readlink(each))
        with suppress(ProcessLookupError), pidfd_of(pid) as process:
            os.kill(pid, number)
            # It is readable when all threads have ended, and with them their sockets.
            assert process is not None
            assert readable_within(process, DEADLINE_S), "it has not ended"
        for name in own:
            if re.fullmatch(rf"{SHARED_MEMORY}/fastrtps_[0-9a-f]+_el", name):  # locked by its owner
                for path in SHARED_MEMORY.glob(f"{Path(name).name.removesuffix('_el')}*"):
                    path.unlink(missing_ok=True)

    def shared_memory(self) -> list[Path]:
        """Return the files in /dev/shm for the ports of this domain (DDSI-RTPS 9.6.2.3)."""
        first = 7400 + 250 * self.domain_id
        ports = range(first, first + 250)
        found = []
        for path in SHARED_MEMORY.glob("*fastrtps_port*"):
            digits = re.search(r"port(\d+)", path.name)
            if digits and int(digits[1]) in ports:
                found.append(path)
        return found

    def end(self) -> list[str]:
        """Kill and remove all that is left; return a line for each leftover and wrong recording.

        The process that indexes a closed recording outlives its daemon, and ends by itself.
        """
        with suppress(AssertionError):
            until(lambda: not any(INDEXING in command for command in self.processes().values()))
        left = [f"process {pid}: {command}" for pid, command in self.processes().items()]
        for pid in self.processes():
            with suppress(OSError):
                self.kill(pid)
        for process in self._spawned:
            with process:  # reaps it, and closes its pipes
                pass
        left += [f"socket {path}" for path in self.sockets()]
        if not self._killed:  # a killed process leaves its ports, and those of its neighbours
            ours = [path for path in self.shared_memory() if path not in self._memory_before]
            left += [f"memory {path}" for path in ours]
        for path in self.shared_memory():
            path.unlink(missing_ok=True)
        left += contradictions(self.folder, may_lack=bool(self.may_lack), killed=self._killed)
        rmtree(self.folder)
        return left


NewPeer = Callable[[World], Peer]
"""Starts another ROS process in a world."""

InProcess = Callable[..., Any]
"""Runs a daemon in the test's loop with the given options."""


@contextmanager
def new_world() -> Iterator[World]:
    """Make a world that ends with the block; a leftover process, file or wrong recording fails."""
    with reserved_domain() as domain_id:
        made = World(Path(tempfile.mkdtemp(prefix="rd-", dir="/tmp")), domain_id)
        left = ["the test did not end"]
        try:
            yield made
        finally:
            left = made.end()
        if left:
            raise AssertionError(f"left behind: {', '.join(left)}")


@contextmanager
def world_with_daemon(*options: str, settings: str = "") -> Iterator[World]:
    """Make a world in which a daemon runs, by default with a simulated robot."""
    with new_world() as made:
        made.ok("start", *(options or ("--sim",)), settings=settings)
        yield made
        made.ok("stop")


def read_back(folder: Path) -> dict[str, list[Any]]:
    """Read a recording with the `mcap` package; return its messages by topic."""
    from mcap.reader import make_reader

    topics: dict[str, list[Any]] = {}
    for path in sorted(folder.glob("*.mcap")):
        with path.open("rb") as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            assert summary is not None
            for channel in summary.channels.values():
                topics.setdefault(channel.topic, [])
            for _, channel, message in reader.iter_messages():
                topics[channel.topic].append(message)
    return topics


def entries_of(file: Path) -> list[JournalEntry]:
    """Return the journal in one file, read by robotctl."""
    with Recording(file) as recording:
        return [each.entry for each in read_journal(recording, on_missing=pytest.fail)]


def journal_of(folder: Path) -> list[JournalEntry]:
    """Return the journal by sequence number: its log times may jump, as when the clock is set."""
    entries = (decode(each.data) for each in read_back(folder).get("/robotctl/journal", []))
    return sorted(entries, key=lambda entry: entry.seq)
