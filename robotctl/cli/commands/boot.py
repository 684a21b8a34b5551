"""boot: systemd units that start a robot's daemon, and units that copy its recordings."""

from __future__ import annotations

import getpass
import os
import pwd
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from robotctl.base.errors import Refused, RobotctlError, UsageError
from robotctl.base.paths import (
    DEFAULT_ROBOT,
    RUNTIME_VARIABLE,
    STATE_VARIABLE,
    check_robot_name,
    state_folder,
    unit_runtime_base,
)
from robotctl.cli.options import Json, Robot, new_app, new_group
from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import printable

app = new_app()
boot = new_group(app, "boot")
sync = new_group(boot, "sync")

System = Annotated[
    bool, typer.Option("--system", help="A unit of the machine, not of the user; needs root.")
]
UnitUser = Annotated[
    str, typer.Option("--user", metavar="USER", help="Who runs it [default: you].")
]
StartWords = Annotated[
    list[str] | None,
    typer.Argument(metavar="[-- OPTION...]", help="Options of start, such as --no-sim."),
]
SyncWords = Annotated[
    list[str], typer.Argument(metavar="-- [FROM] TO [OPTION...]", help="What robotctl sync takes.")
]
Every = Annotated[
    int, typer.Option(min=1, metavar="MIN", help="Minutes from the end of a run to the next.")
]

SYSTEM_FOLDER: Final = Path("/etc/systemd/system")

PASSED_ON: Final = (
    "ROS_DOMAIN_ID",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "ROS_SUPER_CLIENT",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "RMW_IMPLEMENTATION",
)
"""Variables of this shell for the daemon's unit; a user unit also gets STATE_VARIABLE."""

NOT_IN_A_UNIT: Final = ("--drive", "--foreground", "--dry-run", "--json", "--robot")

CALL_S: Final = 60.0
"""The time limit of a systemctl call [s]."""

_DAEMON: Final = """\
Type=notify
NotifyAccess=main
Restart=on-failure
RestartSec=2
RestartPreventExitStatus=2 5
WatchdogSec=10
TimeoutStopSec=30"""
"""No restart after exit code 2 (configuration) or 5 (already running): it would fail again."""

_COPIES: Final = """\
Type=oneshot
Nice=19
CPUSchedulingPolicy=batch
IOSchedulingClass=idle"""


@dataclass(frozen=True, slots=True)
class Unit:
    """The path and the text of a systemd unit: a system unit if `system`, otherwise a user unit."""

    path: Path
    text: str
    system: bool


@boot.callback()
def _boot() -> None:
    """Start the daemon at boot, by a systemd unit.

    \b
    Examples:
      robotctl boot show -- --no-sim --config robot.yaml
      robotctl boot install -- --no-sim --config robot.yaml
      robotctl boot remove
    """


@boot.command()
def show(
    arguments: StartWords = None,
    system: System = False,
    user: UnitUser = "",
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Print the unit that `boot install` would write, for packages and containers.

    \b
    Examples:
      robotctl boot show -- --no-sim > robotctl.service
    """
    unit = daemon_unit(robot, arguments or [], system=system, user=user)
    answer = {"path": str(unit.path), "text": unit.text}
    print_answer(answer, [unit.text.rstrip("\n")], as_json=as_json)


@boot.command()
def install(
    arguments: StartWords = None,
    system: System = False,
    user: UnitUser = "",
    now: Annotated[bool, typer.Option("--now/--later", help="Start it at once.")] = True,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Write the systemd unit of the daemon, enable it, and start it.

    A daemon that fails is started again; the restart never moves the robot. For a unit of yours
    to run while you are not logged in: loginctl enable-linger.

    \b
    Examples:
      robotctl boot install -- --no-sim --config robot.yaml
      sudo robotctl boot install --system --user ros -- --no-sim
    """
    unit = daemon_unit(robot, arguments or [], system=system, user=user)
    problem, lines = _install([unit], now=now)
    if system:
        variable = f"export {RUNTIME_VARIABLE}={unit_runtime_base(robot)}"
        lines.append(
            f"commands of {user or me()}, and of members of socket.group, reach it by: {variable}"
        )
    answer = {"path": str(unit.path), "enabled": not problem, "problem": problem}
    print_answer(answer, lines, as_json=as_json)


@boot.command()
def remove(system: System = False, robot: Robot = DEFAULT_ROBOT, as_json: Json = False) -> None:
    """Stop the daemon that systemd started, and delete its unit; recordings stay.

    \b
    Examples:
      robotctl boot remove
    """
    path = unit_path(robot, system=system)
    problem, lines = _remove([path], "boot install", system=system)
    print_answer({"path": str(path), "problem": problem}, lines, as_json=as_json)


@sync.callback()
def _sync() -> None:
    """Copy recordings to a store regularly, by a systemd timer of its own.

    \b
    Examples:
      robotctl boot sync show -- s3://bucket/robots/one
      robotctl boot sync install -- s3://bucket/robots/one
      robotctl boot sync remove
    """


@sync.command("show")
def show_sync(
    words: SyncWords,
    every: Every = 10,
    system: System = False,
    user: UnitUser = "",
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Print the service and the timer that `boot sync install` would write.

    \b
    Examples:
      robotctl boot sync show -- s3://bucket/robots/one
    """
    units = sync_units(robot, words, system=system, user=user, every_min=every)
    answer = {"units": [{"path": str(each.path), "text": each.text} for each in units]}
    lines = [f"# {each.path}\n{each.text}" for each in units]
    print_answer(answer, ["\n".join(lines).rstrip("\n")], as_json=as_json)


@sync.command("install")
def install_sync(
    words: SyncWords,
    every: Every = 10,
    system: System = False,
    user: UnitUser = "",
    now: Annotated[bool, typer.Option("--now/--later", help="Start the timer at once.")] = True,
    robot: Robot = DEFAULT_ROBOT,
    as_json: Json = False,
) -> None:
    """Write a service that runs `robotctl sync`, and its timer; enable the timer, and start it.

    The service has the lowest CPU and disk priority. Put credentials (AWS_ACCESS_KEY_ID=...) into
    the file sync.env that the service names; only the service's user should be able to read it.

    \b
    Examples:
      robotctl boot sync install -- s3://bucket/robots/one
      sudo robotctl boot sync install --system --user ros -- s3://bucket/robots/one
    """
    timer, service = sync_units(robot, words, system=system, user=user, every_min=every)
    problem, lines = _install([service, timer], now=now)
    answer = {"paths": [str(service.path), str(timer.path)], "problem": problem}
    print_answer({**answer, "enabled": not problem}, lines, as_json=as_json)


@sync.command("remove")
def remove_sync(
    system: System = False, robot: Robot = DEFAULT_ROBOT, as_json: Json = False
) -> None:
    """Stop the timer, and remove it with its service; recordings and copies stay.

    \b
    Examples:
      robotctl boot sync remove
    """
    service = unit_path(robot, "-sync", system=system)
    paths = [each for each in (service.with_suffix(".timer"), service) if each.exists()]
    problem, lines = _remove(paths or [service], "boot sync install", system=system)
    answer = {"paths": [str(path) for path in paths], "problem": problem}
    print_answer(answer, lines, as_json=as_json)


def daemon_unit(robot: str, words: list[str], *, system: bool, user: str) -> Unit:
    """Return the unit that runs `robotctl start` for `robot` with the arguments `words`.

    Raises:
        UsageError: There is no such user, or an argument is not allowed in a unit.
    """
    names = PASSED_ON if system else (STATE_VARIABLE, *PASSED_ON)
    given = [f"{name}={os.environ[name]}" for name in names if name in os.environ]
    settings = [_DAEMON, *(f"Environment={quoted(each)}" for each in given)]
    if system:
        runtime = unit_runtime_base(robot)
        settings += [f"RuntimeDirectory={runtime.name}", "RuntimeDirectoryMode=0711"]
    from robotctl.cli.commands.start import app as start

    options, _ = _command_words("start", start, words)
    command = ["start", "--foreground", "--robot", robot, *options]
    path = unit_path(robot, system=system)
    target = "multi-user.target" if system else "default.target"
    about = f"the daemon of robot {robot}\nAfter=network.target"
    service = _service(robot, command, settings, system=system, user=user)
    return Unit(path, _text(about, service, target), system)


def sync_units(
    robot: str, words: list[str], *, system: bool, user: str, every_min: int
) -> tuple[Unit, Unit]:
    """Return a timer, and its service, which runs `robotctl sync` with the arguments `words`.

    A run starts `every_min` minutes after the end of the previous one.

    Raises:
        UsageError: There is no such user, or an argument is not allowed in a unit.
    """
    from robotctl.cli.commands.recordings.sync import app as copies

    arguments, given = _command_words("sync", copies, words)
    command = ["sync", *arguments, "--robot", robot]
    # In a file, because other users may be able to read a unit.
    credentials = _state_of(user, system=system) / robot / "sync.env"
    settings = [_COPIES, f"EnvironmentFile=-{quoted(str(credentials))}"]
    has_from = len(given["places"]) > 1
    service = _service(robot, command, settings, system=system, user=user, has_from=has_from)
    # The first run comes after two minutes: until then, a starting daemon is not slowed down.
    timer = f"[Timer]\nOnActiveSec=120\nOnUnitInactiveSec={every_min}min\n"
    about = f"the recordings of robot {robot} are copied"
    path = unit_path(robot, "-sync", system=system)
    return (
        Unit(path.with_suffix(".timer"), _text(f"when {about}", timer, "timers.target"), system),
        Unit(path, _text(about, service), system),
    )


def unit_path(robot: str, suffix: str = "", *, system: bool) -> Path:
    """Return the path of a system or user unit of `robot`; `suffix` follows the robot's name.

    Raises:
        UsageError: The name is not allowed for a robot.
    """
    config = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    folder = SYSTEM_FOLDER if system else Path(config) / "systemd" / "user"
    return folder / f"robotctl-{check_robot_name(robot)}{suffix}.service"


def quoted(word: str) -> str:
    """Return `word` quoted for a unit file, by the rules of systemd.syntax(7).

    Raises:
        UsageError: The word has a character that is not printable.
    """
    if not word.isprintable():
        raise UsageError(f"{word!r} cannot stand in a unit file", "use printable characters")
    escaped = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{escaped}"' if set(escaped) & set(" \\\"'") else escaped


def me() -> str:
    """Return the name of this user; under sudo, the name of the user who called sudo."""
    return os.environ.get("SUDO_USER") or getpass.getuser()


def _text(about: str, section: str, wanted_by: str = "") -> str:
    install = f"\n[Install]\nWantedBy={wanted_by}\n" if wanted_by else ""
    return f"[Unit]\nDescription=robotctl, {about}\n\n{section}{install}"


def _service(
    robot: str,
    words: list[str],
    settings: list[str],
    *,
    system: bool,
    user: str,
    has_from: bool = False,
) -> str:
    """Return the [Service] section of a unit that runs robotctl with `words`.

    Unless `has_from`, or given in `words`, --recordings is added.
    """
    command = [str(Path(sys.executable).with_name("robotctl")), *words]
    if not (has_from or any(word.partition("=")[0] == "--recordings" for word in words)):
        folder = _state_of(user, system=system) / "recordings" / robot
        command += ["--recordings", str(folder)]
    lines = [f"ExecStart={' '.join(map(quoted, command))}", *settings, "UMask=0077"]
    if system:
        runtime = unit_runtime_base(robot)
        lines += [f"User={user or me()}", f"Environment={RUNTIME_VARIABLE}={runtime}"]
    return "\n".join(["[Service]", *lines, ""])


def _state_of(user: str, *, system: bool) -> Path:
    """Return the state folder (logs, recordings) of the unit's user.

    Raises:
        UsageError: There is no such user.
    """
    if not system:
        return state_folder()
    try:
        return Path(pwd.getpwnam(user or me()).pw_dir) / ".local" / "state" / "robotctl"
    except KeyError:
        raise UsageError(f"there is no user {user!r}", "name one with --user") from None


def _command_words(
    command: str, app: typer.Typer, words: list[str]
) -> tuple[list[str], dict[str, Any]]:
    """Return the arguments of a command, with absolute paths, and their parsed values.

    Raises:
        UsageError: An argument is not allowed in a unit.
    """
    from robotctl.base.store.objects import is_url

    for word in words:
        name = word.partition("=")[0]
        if name in NOT_IN_A_UNIT:
            cure = "nothing moves at a boot" if name == "--drive" else "leave it out"
            raise UsageError(f"{word} in a unit", cure)
    parser = typer.main.get_group(app).commands[command]
    given = parser.make_context(f"robotctl {command}", list(words)).params
    has_path: set[Any] = {
        each.name
        for each in parser.params
        if each.type.name == "path" or each.param_type_name == "argument"
    }
    listed = (
        value if isinstance(value, list | tuple) else [value]
        for name, value in given.items()
        if name in has_path
    )
    values = [str(each) for several in listed for each in several]
    paths = {value for value in values if not is_url(value)}

    def absolute(word: str) -> str:
        name, sign, value = word.rpartition("=")
        return f"{name}{sign}{Path(value).absolute()}" if value in paths else word

    return [absolute(word) for word in words], given


def _install(units: list[Unit], *, now: bool) -> tuple[str, list[str]]:
    """Write units, enable the last one, and start it if `now`.

    Return systemd's error ("" for none) and the lines to print.

    Raises:
        RobotctlError: A file cannot be written.
    """
    for unit in units:
        try:
            unit.path.parent.mkdir(parents=True, exist_ok=True)
            unit.path.write_text(unit.text)
        except OSError as error:
            raise _not_changed(unit.path, error, system=unit.system) from None
    system, name = units[-1].system, units[-1].path.name
    enable = ("enable", *(("--now",) if now else ()), name)
    problem = _systemctl("daemon-reload", system=system) or _systemctl(*enable, system=system)
    lines = [f"{unit.path} written" for unit in units]
    if problem:
        command = f"systemctl {'' if system else '--user '}enable --now {name}"
        lines.append(f"systemd did not accept it ({problem}); once it runs: {command}")
    else:
        lines[-1] += ", enabled and started" if now else ", enabled"
    return problem, lines


def _remove(paths: list[Path], installer: str, *, system: bool) -> tuple[str, list[str]]:
    """Stop and remove units; return systemd's error ("" for none) and the lines to print.

    `installer` is the command in the error's advice.

    Raises:
        Refused: There is no unit.
        RobotctlError: A file cannot be removed.
    """
    if not paths[0].exists():
        raise Refused(f"there is no {paths[-1]}", f"robotctl {installer} writes one")
    problems = []
    for path in paths:
        problems.append(_systemctl("disable", "--now", path.name, system=system))
        try:
            path.unlink()
        except OSError as error:
            raise _not_changed(path, error, system=system) from None
    _systemctl("daemon-reload", system=system)
    problem = next(filter(None, problems), "")
    ended = f"; systemd: {problem}" if problem else ", and stopped"
    return problem, [f"{', '.join(map(str, paths))} removed{ended}"]


def _systemctl(*words: str, system: bool) -> str:
    """Run systemctl; return the reason of a failure, or ""."""
    command: Iterable[str] = ("systemctl", *(() if system else ("--user",)), *words)
    try:
        done = subprocess.run(list(command), capture_output=True, text=True, timeout=CALL_S)
    except FileNotFoundError:
        return "there is no systemctl on this machine"
    except subprocess.TimeoutExpired:
        return f"no answer within {CALL_S:g} s"
    text = " ".join(done.stderr.split())
    return printable(text or f"exit code {done.returncode}") if done.returncode else ""


def _not_changed(path: Path, error: OSError, *, system: bool) -> RobotctlError:
    return RobotctlError(f"{path}: {error.strerror}", "use sudo" if system else "check the folder")
