"""Where a robot's socket, lock, log and latch lie; standard library only."""

from __future__ import annotations

import os
import re
from pathlib import Path

from robotctl.errors import UsageError
from robotctl.trust import Chain

DEFAULT_ROBOT = "robot"
MAX_SOCKET_PATH_BYTES = 107
"""`sun_path` holds 108 bytes with its terminating zero (unix(7))."""

MAX_ROBOT_NAME_LENGTH = 48
SHARED_FOLDER = Path("/tmp")
"""For the sockets of a user without RUNTIME_VARIABLE; anybody may make a folder in it."""

RUNTIME_VARIABLE = "XDG_RUNTIME_DIR"
STATE_VARIABLE = "XDG_STATE_HOME"
ROBOT_VARIABLE = "ROBOTCTL_ROBOT"
"""The default of `--robot`, as an environment variable."""

_ROBOT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def check_robot_name(name: str) -> str:
    """Return `name` if it can be a ROS namespace and a file name; raises UsageError."""
    if len(name) > MAX_ROBOT_NAME_LENGTH or not _ROBOT_NAME.fullmatch(name) or "__" in name:
        raise UsageError(
            f"robot name {name!r}",
            "use a letter, then letters, digits and single underscores, "
            f"at most {MAX_ROBOT_NAME_LENGTH}",
        )
    return name


def namespace_of(robot: str) -> str:
    """Return the robot's ROS namespace: none for the default robot, else its name."""
    return "" if robot == DEFAULT_ROBOT else f"/{robot}"


def runtime_folder() -> Path:
    """The folder of sockets and locks: private to the user, gone after a reboot."""
    base = os.environ.get(RUNTIME_VARIABLE) or SHARED_FOLDER / f"robotctl-{os.getuid()}"
    return Path(base) / "robotctl"


def state_folder() -> Path:
    """The folder of logs and emergency-stop latches: survives a reboot.

    Raises UsageError for a user without a home.
    """
    base = os.environ.get(STATE_VARIABLE)
    try:
        return Path(base or Path.home() / ".local" / "state") / "robotctl"
    except RuntimeError:  # neither HOME nor the machine's list of users names one
        raise UsageError("you have no home folder", "set XDG_STATE_HOME to a folder") from None


def chain_to(folder: Path) -> Chain:
    """What has to be trusted for what lies in a folder of this module; else the folder alone."""
    runtime = runtime_folder()
    if folder.is_relative_to(runtime):
        return Chain(runtime.parent, folder, RUNTIME_VARIABLE)
    state = state_folder()
    base = state.parent if folder.is_relative_to(state) else folder
    return Chain(base, folder, STATE_VARIABLE)


def make_private(folder: Path) -> Path:
    """Create `folder` for this user alone; raises UsageError if another user could change it."""
    chain_to(folder).make()
    return folder


def socket_path(robot: str) -> Path:
    """The robot's control socket; raises UsageError where the path is too long for a socket."""
    path = runtime_folder() / f"{check_robot_name(robot)}.sock"
    if len(os.fsencode(path)) > MAX_SOCKET_PATH_BYTES:
        raise UsageError(
            f"socket path {path} is longer than {MAX_SOCKET_PATH_BYTES} bytes",
            "set XDG_RUNTIME_DIR to a shorter folder",
        )
    return path


def lock_path(robot: str) -> Path:
    """The file whose flock makes a process the robot's only daemon; it holds the owner's pid."""
    return runtime_folder() / f"{check_robot_name(robot)}.lock"


def robot_state_folder(robot: str) -> Path:
    """The robot's folder for what must outlive the daemon."""
    return state_folder() / check_robot_name(robot)


def log_path(robot: str) -> Path:
    """The background daemon's log."""
    return robot_state_folder(robot) / "daemon.log"


def latch_path(robot: str) -> Path:
    """The file whose existence latches EMERGENCY_STOP over restarts; its text is the reason."""
    return robot_state_folder(robot) / "emergency-stop"


def recordings_note_path(robot: str) -> Path:
    """The file that names the folder into which the robot's last daemon has recorded."""
    return robot_state_folder(robot) / "recordings"
