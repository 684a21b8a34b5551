"""The systemd units that copy a robot's recordings to a store: a service, and its timer."""

from __future__ import annotations

from robotctl.cli.support.boot_unit import Unit, program_of, quoted, state_of, unit_path
from robotctl.paths import RUNTIME_VARIABLE, unit_runtime_base

FIRST_S = 120
"""After the start of the timer: the daemon has the machine for itself while it starts."""


def sync_units(
    robot: str, arguments: tuple[str, ...], *, system: bool, user: str, every_min: int
) -> tuple[Unit, Unit]:
    """Return the timer and the service that runs `robotctl sync` with these arguments.

    A run starts `every_min` minutes after the one before it has ended. Credentials come from a
    file, which is not read by other users: a unit can be.

    Raises:
        UsageError: There is no such user, or a word cannot stand in a unit.
    """
    state = state_of(user, system=system)
    command: tuple[str, ...] = (program_of(), "sync", *arguments, "--robot", robot)
    if not any(word.partition("=")[0] == "--recordings" for word in arguments):
        command += ("--recordings", str(state / "recordings" / robot))
    lines = [
        "[Unit]",
        f"Description=robotctl, copies the recordings of robot {robot}",
        "",
        "[Service]",
        "Type=oneshot",
        f"ExecStart={' '.join(map(quoted, command))}",
        "Nice=19",
        "CPUSchedulingPolicy=batch",
        "IOSchedulingClass=idle",
        "UMask=0077",
        f"EnvironmentFile=-{quoted(str(state / robot / 'sync.env'))}",
    ]
    if system:
        lines += [f"User={user}", f"Environment={RUNTIME_VARIABLE}={unit_runtime_base(robot)}"]
    timer = [
        "[Unit]",
        f"Description=robotctl, when the recordings of robot {robot} are copied",
        "",
        "[Timer]",
        f"OnActiveSec={FIRST_S}",
        f"OnUnitInactiveSec={every_min}min",
        "",
        "[Install]",
        "WantedBy=timers.target",
        "",
    ]
    scope = () if system else ("--user",)
    path = unit_path(f"{robot}-sync", system=system)
    return (
        Unit(path.with_suffix(".timer"), "\n".join(timer), scope),
        Unit(path, "\n".join([*lines, ""]), scope),
    )
