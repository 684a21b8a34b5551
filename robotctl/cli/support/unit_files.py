"""Writes and removes the files of systemd units."""

from __future__ import annotations

from pathlib import Path

from robotctl.cli.support.boot_unit import Unit
from robotctl.cli.support.systemd import systemctl
from robotctl.errors import RobotctlError


def write_unit(made: Unit) -> None:
    """Write the file of a unit.

    Raises:
        RobotctlError: It cannot be written.
    """
    try:
        made.path.parent.mkdir(parents=True, exist_ok=True)
        made.path.write_text(made.text)
    except OSError as error:
        raise _not_changed(made.path, made.scope, error) from None


def enable_unit(made: Unit, *, now: bool) -> str:
    """Let systemd start a unit that is written; return why it does not, "" if it does."""
    problem = systemctl(made.scope, "daemon-reload")
    return problem or systemctl(made.scope, "enable", *(("--now",) if now else ()), made.name)


def enabling_command(made: Unit) -> str:
    """Return what a user types to enable a unit."""
    return " ".join(("systemctl", *made.scope, "enable --now", made.name))


def remove_unit(path: Path, *, system: bool) -> str:
    """Stop a unit and remove its file; return what systemd said against it, or "".

    Raises:
        RobotctlError: The file cannot be removed.
    """
    scope = () if system else ("--user",)
    problem = systemctl(scope, "disable", "--now", path.name)
    try:
        path.unlink()
    except OSError as error:
        raise _not_changed(path, scope, error) from None
    systemctl(scope, "daemon-reload")
    return problem


def _not_changed(path: Path, scope: tuple[str, ...], error: OSError) -> RobotctlError:
    return RobotctlError(f"{path}: {error.strerror}", "check the folder" if scope else "use sudo")
