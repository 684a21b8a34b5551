"""doctor: find what is wrong with this computer or its ROS graph."""

from __future__ import annotations

import os
import sys
import sysconfig
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from robotctl import doctor as checks
from robotctl.base.domains import discovery_range, requested_domain, wider_discovery
from robotctl.base.environment import RANGE, limit_discovery
from robotctl.base.errors import AlreadyRunning, Refused, RobotctlError, UsageError
from robotctl.base.paths import (
    DEFAULT_ROBOT,
    check_robot_name,
    lock_path,
    runtime_folder,
    socket_path,
    state_folder,
)
from robotctl.cli.options import ConfigFile, DomainId, Json, Robot, new_app
from robotctl.cli.targets import robots
from robotctl.cli.targets.robots import RobotDaemon
from robotctl.cli.targets.ros_view import RosView, ros_view
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import printable
from robotctl.config import Config, load
from robotctl.daemon.lock import is_owned, owned
from robotctl.doctor import Finding, Level, fault, ok, warning
from robotctl.ipc.answers import GraphTopic, Status
from robotctl.ipc.client import call
from robotctl.ipc.method_names import STATUS

app = new_app()


@app.command()
def doctor(
    clean: Annotated[
        bool, typer.Option("--clean", help="Remove what killed processes of you left.")
    ] = False,
    robot: Robot = DEFAULT_ROBOT,
    config: ConfigFile = None,
    domain_id: DomainId = None,
    as_json: Json = False,
) -> None:
    """Find what is wrong here: installation, discovery, ROS graph, machine.

    It looks at the shell, command and odometry on ROS, shared memory, disk, clock and permissions.
    Exit code 0 if there is no fault (a warning is no fault), else 4.

    \b
    Examples:
      robotctl doctor
      robotctl doctor --clean
      robotctl doctor --json
    """

    removed, found = diagnose(robot, config, domain_id, clean=clean)
    faults = [each for each in found if each.level is Level.FAULT]
    answer = {"findings": [each.as_object() for each in found], "removed": removed}
    error = None
    if faults:
        count = f"{len(faults)} fault{'s' if len(faults) > 1 else ''}"
        error = Refused(f"{count}, the first: {faults[0].text}", faults[0].cure)
    print_answer(answer, _lines(removed, found), as_json=as_json, error=error)


def _lines(removed: list[str], found: list[Finding]) -> Iterator[str]:
    """Yield a line for each finding, and one for each cure."""
    width = max((len(each.check) for each in found), default=0)
    order = {Level.OK: 0, Level.WARNING: 1, Level.FAULT: 2}
    if removed:
        yield f"removed {len(removed)} files of dead processes"
    for each in sorted(found, key=lambda each: order[each.level]):
        yield f"{each.level.value:8} {each.check:{width}}  {printable(each.text)}"
        if each.cure:
            yield f"{'':8} {'':{width}}  cure: {printable(each.cure)}"


def diagnose(
    robot: str, config: Path | None, domain_id: int | None, *, clean: bool
) -> tuple[list[str], list[Finding]]:
    """Run all checks, and remove stale files if `clean`; return removed files and findings.

    Raises:
        UsageError: The name of the robot, the configuration or the domain is wrong.
    """
    check_robot_name(robot)
    chosen = Config() if config is None else load(config)
    sockets = (*_check_socket(robot), *checks.check_folders(runtime_folder()))
    usable = all(each.level is not Level.FAULT for each in sockets)
    removed = checks.clean() if clean else []
    if clean and usable:
        removed += _remove_sockets()
    daemons = _daemons() if usable else []
    wrong = [*_killed(), *(_hangs(each) for each in daemons if each.problem)] if usable else []
    ours = next((each for each in daemons if each.robot == robot), None)
    if domain_id is None and (not usable or (ours and ours.problem)):
        domain_id = requested_domain(None) or 0  # the daemon cannot report its domain
    disk = _disk(ours.status if ours else None)
    found = [*_computer(robot, chosen), *disk, *wrong, *_ros(robot, chosen, domain_id)]
    return [str(path) for path in removed], found


def _check_socket(robot: str) -> Iterator[Finding]:
    try:
        socket_path(robot)
    except UsageError as error:  # the path is too long
        yield fault("socket", error.cause, error.cure)


def _robots() -> Iterator[str]:
    """Yield the robots with a socket, without names that no robot may have."""
    for name in robots.names():
        with suppress(UsageError):
            yield check_robot_name(name)


def _daemons() -> list[RobotDaemon]:
    """Return all daemons; a silent daemon is asked twice."""
    found = robots.find(_robots())
    answered = [each for each in found if not each.problem]
    return [*answered, *robots.find(each.robot for each in found if each.problem)]


def _hangs(daemon: RobotDaemon) -> Finding:
    cure = f"robotctl start --robot {daemon.robot} tells its pid: kill -9 it, then start again"
    return fault("daemon", daemon.problem, cure)


def _disk(status: Status | None) -> Iterator[Finding]:
    """Check the disk of the folder for recordings."""
    file = status["recorder"]["file"] if status else ""
    if file:
        yield from checks.check_disk(Path(file).parent.parent, is_used=True)
    else:
        yield from checks.check_disk(Path("recordings").absolute())


def _killed() -> Iterator[Finding]:
    for robot in dead_robots():
        text = f"the daemon of robot {robot} was killed, and its socket is left"
        cure = f"robotctl start --robot {robot} cleans up, and repairs the recording"
        yield warning("dead processes", text, cure)


def dead_robots() -> list[str]:
    """Return the robots with a socket of a killed daemon."""
    found = []
    for robot in robots.names():
        with suppress(UsageError):  # not a name of a robot
            if not is_owned(lock_path(robot)):
                found.append(robot)
    return found


def _remove_sockets() -> list[Path]:
    """Remove and return the sockets of killed daemons."""
    from robotctl.ipc.listener import remove_stale

    removed = []
    for robot in dead_robots():
        with suppress(AlreadyRunning, UsageError), owned(lock_path(robot), robot):
            remove_stale(socket_path(robot))
            removed.append(socket_path(robot))
    return removed


def _computer(robot: str, config: Config) -> Iterator[Finding]:
    prefix, base = Path(sys.prefix), Path(sys.base_prefix)
    yield from checks.check_wheels()
    yield from checks.check_shell(os.environ, prefix)
    yield from checks.check_two_rclpys(sys.path)
    yield from checks.check_middleware(os.environ)
    yield from checks.check_range(os.environ)
    yield from checks.check_profiles(os.environ)
    yield from checks.check_pip(prefix, base, Path(sysconfig.get_path("stdlib")))
    yield from checks.check_memory()
    yield from checks.check_clock(time.time(), state_folder())
    yield from _check_socket(robot)
    yield from checks.check_folders(runtime_folder(), state_folder())
    yield from checks.check_descriptors()
    yield from checks.check_priority(config.fifo_priority)


def _ros(robot: str, config: Config, domain_id: int | None) -> Iterator[Finding]:
    try:
        view = ros_view(robot, domain_id)
        limit_discovery()  # as a start does
        if view.through_daemon:
            yield from _check_daemons_range(call(robot, STATUS)["discovery_range"])
        shell = requested_domain(domain_id) or 0
        if shell != view.domain_id:
            yield warning(
                "discovery",
                f"the daemon is in domain {view.domain_id}, this shell in {shell}: "
                "other programs of this shell do not see the robot",
                f"export ROS_DOMAIN_ID={view.domain_id}",
            )
        wider = wider_discovery()
        reach = f"other machines are discovered: {wider}" if wider else "this machine only"
        if discovery_range() == "OFF":
            reach = "no other process is discovered"
        yield ok("discovery", f"domain {view.domain_id}, {reach}")
        names = view.names()
        yield ok("nodes", ", ".join(names["nodes"]) or f"none in domain {view.domain_id}")
        kernel = config.kernel
        used = {each["name"] for each in names["topics"]}
        odometry = _topic(view, kernel.odometry.topic, used)
        has_odometry = bool(odometry["publishers"])
        command = _topic(view, kernel.command.topic, used)
        yield from checks.check_command(command, has_odometry=has_odometry)
        yield from checks.check_odometry(odometry)
        yield from checks.check_definitions(names["topics"])
    except UsageError:
        raise
    except RobotctlError as error:
        cure = "check what it names, the ROS variables (env), memory and limits (ulimit -a)"
        text = f"the graph cannot be seen: {error.cause or error}"
        yield fault("ROS", text, error.cure or cure)


def _check_daemons_range(daemons: str) -> Iterator[Finding]:
    """Use the daemon's discovery range from now on, and warn if this shell has another."""
    if daemons != discovery_range():
        yield warning(
            "discovery",
            f"the range of the daemon is {daemons}, that of this shell {discovery_range()}",
            f"end the daemon and start it from a shell with the right {RANGE}",
        )
    os.environ[RANGE] = daemons


def _topic(view: RosView, name: str, used: set[str]) -> GraphTopic:
    full = view.full_name(name)
    with suppress(UsageError):  # the topic's last node has just left
        if full in used:
            return view.topic(full)
    return {"name": full, "types": [], "publishers": [], "subscriptions": []}
