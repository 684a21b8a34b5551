"""The paths of a robot's socket, lock, log and latch. Standard library only.

A function that needs a valid robot's name or a home folder raises UsageError without it.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from robotctl.base.errors import UsageError
from robotctl.base.trust import SYSTEM_RUNTIME, UNIT_PREFIX, FolderChain

DEFAULT_ROBOT = "robot"
MAX_SOCKET_PATH_BYTES = 107
"""`sun_path` holds 108 bytes with its terminating zero (unix(7))."""

MAX_ROBOT_NAME_LENGTH = 48
SHARED_FOLDER = Path("/tmp")
"""The folder of `robotctl-UID` without RUNTIME_VARIABLE; every user may write to it."""

RUNTIME_VARIABLE = "XDG_RUNTIME_DIR"
STATE_VARIABLE = "XDG_STATE_HOME"
ROBOT_VARIABLE = "ROBOTCTL_ROBOT"
"""The environment variable with the default of `--robot`."""

LEASE_VARIABLE = "ROBOTCTL_LEASE"
"""The environment variable with the token of the robot's lease."""

_NAMESPACE_PART = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_ROBOT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def check_robot_name(name: str) -> str:
    """Return `name` if it can be a ROS namespace and a file name.

    Raises:
        UsageError: `name` is not allowed as a namespace or as a file name.
    """
    if len(name) > MAX_ROBOT_NAME_LENGTH or not _ROBOT_NAME.fullmatch(name) or "__" in name:
        raise UsageError(
            f"robot name {name!r}",
            "use a letter, then letters, digits and single underscores, "
            f"at most {MAX_ROBOT_NAME_LENGTH}",
        )
    return name


def namespace_of(robot: str) -> str:
    """Return the robot's ROS namespace `/NAME`, or "" for the default robot."""
    return "" if robot == DEFAULT_ROBOT else f"/{robot}"


def check_namespace(text: str) -> str:
    """Return the ROS namespace `text` in the form `/NAME` or `/A/B`, or "" for none.

    Raises:
        UsageError: ROS does not allow `text`.
    """
    parts = [part for part in text.strip("/").split("/") if text.strip("/")]
    if not all(_NAMESPACE_PART.fullmatch(part) and "__" not in part for part in parts):
        raise UsageError(
            f"namespace {text!r}", "use /NAME or /A/B, of letters, digits and single underscores"
        )
    return "".join(f"/{part}" for part in parts)


def runtime_folder() -> Path:
    """Return the private folder of sockets and locks; a reboot may delete it."""
    base = os.environ.get(RUNTIME_VARIABLE) or SHARED_FOLDER / f"robotctl-{os.getuid()}"
    return Path(base) / "robotctl"


def unit_runtime_base(robot: str) -> Path:
    """Return the XDG_RUNTIME_DIR that the robot's daemon has if a systemd system unit starts it."""
    return SYSTEM_RUNTIME / f"{UNIT_PREFIX}{robot}"


def state_folder() -> Path:
    """Return the folder of logs and emergency-stop latches; it survives a reboot.

    Raises:
        UsageError: The user has no home folder.
    """
    base = os.environ.get(STATE_VARIABLE)
    try:
        return Path(base or Path.home() / ".local" / "state") / "robotctl"
    except RuntimeError:  # neither HOME nor the machine's list of users names one
        raise UsageError("you have no home folder", "set XDG_STATE_HOME to a folder") from None


def chain_to(folder: Path) -> FolderChain:
    """Return the folders to check before a file in `folder` is trusted.

    A folder outside `runtime_folder` and `state_folder` is checked without its parents.
    """
    runtime = runtime_folder()
    if folder.is_relative_to(runtime):
        return FolderChain(runtime.parent, folder, RUNTIME_VARIABLE, may_be_shared=True)
    state = state_folder()
    base = state.parent if folder.is_relative_to(state) else folder
    return FolderChain(base, folder, STATE_VARIABLE)


def make_private(folder: Path) -> Path:
    """Create `folder` with access for this user only, and return it.

    Raises:
        UsageError: Another user could change the folder, or the folder cannot be created.
    """
    chain_to(folder).make()
    return folder


def socket_path(robot: str) -> Path:
    """Return the path of the robot's control socket.

    Raises:
        UsageError: The robot's name is not allowed, or the path is too long for a socket.
    """
    path = runtime_folder() / f"{check_robot_name(robot)}.sock"
    if len(os.fsencode(path)) > MAX_SOCKET_PATH_BYTES:
        raise UsageError(
            f"socket path {path} is longer than {MAX_SOCKET_PATH_BYTES} bytes",
            "set XDG_RUNTIME_DIR to a shorter folder",
        )
    return path


def lock_path(robot: str) -> Path:
    """Return the path of the file that the robot's daemon locks by flock, with its pid."""
    return runtime_folder() / f"{check_robot_name(robot)}.lock"


def robot_state_folder(robot: str) -> Path:
    """Return the robot's folder for files that must outlive the daemon."""
    return state_folder() / check_robot_name(robot)


def log_path(robot: str) -> Path:
    """Return the path of the background daemon's log."""
    return robot_state_folder(robot) / "daemon.log"


def latch_path(robot: str) -> Path:
    """Return the path of the file that latches EMERGENCY_STOP, with the reason in it."""
    return robot_state_folder(robot) / "emergency-stop"


def seal_folder(robot: str) -> Path:
    """Return the folder of the keys that seal the robot's recordings."""
    return robot_state_folder(robot) / "seal"


def recordings_note_path(robot: str) -> Path:
    """Return the path of the file that names the folder of the last daemon's recordings."""
    return robot_state_folder(robot) / "recordings"
