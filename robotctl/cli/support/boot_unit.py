"""The systemd unit that starts a robot's daemon at boot."""

from __future__ import annotations

import os
import pwd
import sys
from dataclasses import dataclass
from pathlib import Path

from robotctl.errors import UsageError
from robotctl.paths import RUNTIME_VARIABLE, STATE_VARIABLE, state_folder, unit_runtime_base

SYSTEM_FOLDER = Path("/etc/systemd/system")

WATCHDOG_S = 10
STOP_S = 30

IN_VAIN = "2 5"
"""Exit codes after which another start would fail again: configuration, already running."""

PASSED_ON = (
    "ROS_DOMAIN_ID",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "ROS_SUPER_CLIENT",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "RMW_IMPLEMENTATION",
)
"""Variables of the installing shell that the unit keeps; one of the user keeps its state, too."""


@dataclass(frozen=True, slots=True)
class Unit:
    """Name, place and text of a unit; `scope` are the options of systemctl for it.

    `runtime` is the folder of its socket, "" where that is the user's own.
    """

    path: Path
    text: str
    scope: tuple[str, ...]
    runtime: str = ""

    @property
    def name(self) -> str:
        """The name that systemctl takes."""
        return self.path.name


def unit_path(robot: str, *, system: bool) -> Path:
    """Return where the unit of a robot belongs."""
    config = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    folder = SYSTEM_FOLDER if system else Path(config) / "systemd" / "user"
    return folder / f"robotctl-{robot}.service"


def unit(robot: str, arguments: tuple[str, ...], *, system: bool, user: str) -> Unit:
    """Return the unit that starts the daemon of `robot` with these arguments of `start`.

    A restart never moves the robot: the daemon begins in IDLE, or in EMERGENCY_STOP if that was
    latched.

    Raises:
        UsageError: There is no such user, or a word cannot stand in a unit.
    """
    recordings = state_of(user, system=system) / "recordings" / robot
    command: tuple[str, ...] = (program_of(), "start", "--foreground", "--robot", robot)
    if "--recordings" not in arguments:
        command += ("--recordings", str(recordings))
    lines = [
        "[Unit]",
        f"Description=robotctl, the daemon of robot {robot}",
        "After=network.target",
        "",
        "[Service]",
        "Type=notify",
        "NotifyAccess=main",
        f"ExecStart={' '.join(map(quoted, (*command, *arguments)))}",
        "Restart=on-failure",
        "RestartSec=2",
        f"RestartPreventExitStatus={IN_VAIN}",
        f"WatchdogSec={WATCHDOG_S}",
        f"TimeoutStopSec={STOP_S}",
        "UMask=0077",
        *(
            f"Environment={quoted(f'{key}={os.environ[key]}')}"
            for key in (*PASSED_ON, *(() if system else (STATE_VARIABLE,)))
            if key in os.environ
        ),
    ]
    runtime = str(unit_runtime_base(robot)) if system else ""
    if system:
        lines += [
            f"User={user}",
            f"RuntimeDirectory={Path(runtime).name}",
            "RuntimeDirectoryMode=0711",  # the folder in it is private, or of `socket.group`
            f"Environment={RUNTIME_VARIABLE}={runtime}",
        ]
    lines += ["", "[Install]", f"WantedBy={'multi-user' if system else 'default'}.target", ""]
    scope = () if system else ("--user",)
    return Unit(unit_path(robot, system=system), "\n".join(lines), scope, runtime)


def program_of() -> str:
    """Return the path of the robotctl that runs."""
    return str(Path(sys.executable).with_name("robotctl"))


def state_of(user: str, *, system: bool) -> Path:
    """Return the folder of logs and recordings that a unit of `user` has.

    Raises:
        UsageError: There is no such user.
    """
    if not system:
        return state_folder()
    try:
        return Path(pwd.getpwnam(user).pw_dir) / ".local" / "state" / "robotctl"
    except KeyError:
        raise UsageError(f"there is no user {user!r}", "name one with --user") from None


def quoted(word: str) -> str:
    """Return a word of a unit file, quoted as systemd.syntax(7) says.

    Raises:
        UsageError: It holds a control character.
    """
    if not word.isprintable():
        raise UsageError(f"{word!r} cannot stand in a unit file", "use printable characters")
    escaped = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{escaped}"' if set(escaped) & set(" \\\"'") else escaped
