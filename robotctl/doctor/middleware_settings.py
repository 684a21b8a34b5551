"""What the environment tells the middleware: which one, how far it discovers, its profiles file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from robotctl.doctor.finding import Finding, warning
from robotctl.environment import RANGE, RMW
from robotctl.regular_file import open_regular

PROFILES: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""The variable in which Fast DDS 2, that of the wheels, looks for a profiles file."""

LOCALHOST_ONLY: Final = "ROS_LOCALHOST_ONLY"
"""The variable of Humble; its value 1 overrules that of RANGE."""

MAX_PROFILES_BYTES: Final = 1_000_000
"""Larger files are no profiles that a person wrote."""

RANGES: Final = ("", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT", "OFF")


def check_middleware(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Name a middleware that is asked for and that robotctl does not use."""
    given = environment.get("RMW_IMPLEMENTATION", "")
    if given not in ("", RMW):
        yield warning(
            "middleware",
            f"RMW_IMPLEMENTATION is {given}: robotctl uses {RMW}, the only one that it brings",
            f"let the nodes of the robot use the same: export RMW_IMPLEMENTATION={RMW}",
        )


def check_range(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Name a discovery range by which fewer processes are discovered than one may expect."""
    check, cure = "discovery", f"export {RANGE}=SUBNET, or LOCALHOST for this machine only"
    given = environment.get(RANGE, "")
    if environment.get(LOCALHOST_ONLY) == "1" and given not in ("", "LOCALHOST"):
        text = f"{LOCALHOST_ONLY}=1 overrules {RANGE}={given}: only this machine is discovered"
        yield warning(check, text, f"unset {LOCALHOST_ONLY} if that is not meant")
    elif given not in RANGES:
        text = f"{RANGE} is {given!r}, which ROS does not know: it takes LOCALHOST"
        yield warning(check, text, cure)
    elif given == "OFF":
        text = f"{RANGE} is OFF: no process discovers another, not even on this machine"
        yield warning(check, text, cure)


def check_profiles(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Name a profiles file of Fast DDS that has no effect, as it cannot be read."""
    given = environment.get(PROFILES)
    if given is None:
        return
    try:
        ElementTree.fromstring(_text_of(Path(given)))
    except (OSError, ElementTree.ParseError, ValueError) as error:
        why = (isinstance(error, OSError) and error.strerror) or f"it is no XML: {error}"
        text = f"{PROFILES} is {given!r}, which Fast DDS cannot read: {why}"
        yield warning("profiles", text, f"name a profiles file, or unset {PROFILES}")


def _text_of(path: Path) -> str:
    """Return the text of a regular file of a bounded size.

    Raises:
        OSError: It cannot be read, or is too large.
    """
    with open_regular(path) as stream:
        data = stream.read(MAX_PROFILES_BYTES + 1)
    if len(data) > MAX_PROFILES_BYTES:
        raise OSError(f"{path} is larger than {MAX_PROFILES_BYTES / 1e6:.0f} MB")
    return data.decode(errors="replace")
