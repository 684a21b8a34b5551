"""Checks of this computer and of its ROS graph; each problem comes with a cure."""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import re
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from importlib import metadata
from itertools import chain, islice
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from robotctl.base import own_process
from robotctl.base.environment import RANGE, RMW, without_foreign_ros
from robotctl.base.errors import RobotctlError
from robotctl.base.files import open_regular
from robotctl.base.paths import chain_to
from robotctl.ipc.answers import GraphEndpoint, GraphTopic, NameAndTypes
from robotctl.kernel.constants import TWIST, TWIST_STAMPED
from robotctl.messages.cdr import ODOMETRY


class Level(Enum):
    """The severity of a finding."""

    OK = "ok"
    WARNING = "warning"
    """Something may fail, or be slow."""
    FAULT = "fault"
    """Something does not work."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of a check; `cure` is the advice, or "" if none is needed."""

    check: str
    level: Level
    text: str
    cure: str = ""

    def as_object(self) -> dict[str, str | None]:
        """Return the object that `doctor --json` prints."""
        return {
            "check": self.check,
            "level": self.level.value,
            "text": self.text,
            "cure": self.cure or None,
        }


def ok(check: str, text: str) -> Finding:
    """Return the finding of a check that found nothing wrong."""
    return Finding(check, Level.OK, text)


def warning(check: str, text: str, cure: str) -> Finding:
    """Return a warning as the finding of the check with this name, with the advice `cure`."""
    return Finding(check, Level.WARNING, text, cure)


def fault(check: str, text: str, cure: str) -> Finding:
    """Return a fault as the finding of the check with this name, with the advice `cure`."""
    return Finding(check, Level.FAULT, text, cure)


SCARCE_BYTES: Final = 2_000_000_000
"""With less free space, the recorder warns (its option `warn_free_bytes`)."""

FULL_BYTES: Final = 500_000_000
"""With less free space, the recorder does not start (its option `stop_free_bytes`)."""

BUILT_S: Final = 1_735_689_600.0
"""2025-01-01 [s since the epoch]; a clock before this was never set."""

AHEAD_S: Final = 60.0
"""If a file is newer than the clock by more than this, the clock was set back."""


def check_disk(folder: Path, *, is_used: bool = False) -> Iterator[Finding]:
    """Check the free space for recordings in `folder`, or in its nearest parent that exists.

    Write access is not checked if `is_used`: a daemon of another user may record there.
    """
    check = "disk"
    existing = _existing(folder)
    other = "choose another with --recordings"
    if not os.path.isdir(existing):
        yield fault(check, f"{existing} is not a folder, nor a link to one", other)
        return
    found = os.statvfs(existing)
    free = found.f_bavail * found.f_frsize
    told = f"{free / 1e9:.1f} GB free for recordings in {folder}"
    cure = "remove old recordings, or set recording.max_total_gb"
    if not is_used and not os.access(existing, os.W_OK | os.X_OK):
        yield fault(check, f"you may not write in {existing}", other)
    elif free < FULL_BYTES or (found.f_files and not found.f_favail):
        yield fault(check, told if free < FULL_BYTES else f"no inode is left in {existing}", cure)
    elif free < SCARCE_BYTES:
        yield warning(check, told, cure)
    else:
        yield ok(check, told)


def check_clock(now_s: float, state: Path) -> Iterator[Finding]:
    """Check that the clock was set, and is not behind the newest file in the folder `state`."""
    check = "clock"
    try:
        newest = max((entry.stat().st_mtime for entry in os.scandir(state)), default=0.0)
    except OSError:
        newest = 0.0
    told = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(now_s))
    cure = "set it, for example by systemd-timesyncd or chrony, before the daemon starts"
    if now_s < BUILT_S:
        yield fault(check, f"it says {told}: it was never set", cure)
    elif newest > now_s + AHEAD_S:
        late = newest - now_s
        yield warning(check, f"it says {told}, but {state} was written {late:.0f} s later", cure)
    else:
        yield ok(check, told)


def check_folders(*folders: Path) -> Iterator[Finding]:
    """Check that the folders of sockets, latches and keys are usable, and safe from other users."""
    wrong = []
    for folder in folders:
        chain = chain_to(folder).for_client()
        try:
            chain.check()
            _check_place(folder)
        except RobotctlError as error:
            wrong.append(fault("permissions", error.cause, error.cure))
        except OSError as error:
            cure = f"set {chain.variable} to a folder of yours"
            text = f"{folder} cannot be used: {error.filename}: {error.strerror}"
            wrong.append(fault("permissions", text, cure))
        else:
            cure = "take the right of the group away: chmod g-w FOLDER"
            wrong += [warning("permissions", each, cure) for each in chain.group_writable()]
    yield from wrong or [ok("permissions", "only you can change sockets, latches and keys")]


def check_descriptors() -> Iterator[Finding]:
    """Check the limit of open files."""
    check = "open files"
    _, limit = resource.getrlimit(resource.RLIMIT_NOFILE)  # a daemon raises its soft limit to it
    told = f"a process may open {limit} at a time"
    if limit == resource.RLIM_INFINITY or limit >= own_process.ENOUGH_OPEN_FILES:
        yield ok(check, told)
    elif limit >= own_process.LEAST_OPEN_FILES:
        text = f"{told}: a daemon may need {own_process.ENOUGH_OPEN_FILES}"
        yield warning(check, text, own_process.MORE_OPEN_FILES)
    else:
        text = f"{told}: a daemon needs {own_process.LEAST_OPEN_FILES} to start"
        yield fault(check, text, own_process.MORE_OPEN_FILES)


def check_priority(fifo_priority: int) -> Iterator[Finding]:
    """Check whether the user's limit allows the configured real-time priority."""
    check = "rtprio"
    limit, _ = resource.getrlimit(resource.RLIMIT_RTPRIO)
    allowed = 99 if limit == resource.RLIM_INFINITY or os.getuid() == 0 else limit
    if fifo_priority > allowed:
        yield warning(
            check,
            f"fifo_priority is {fifo_priority}, and the limit of this user is {allowed}",
            "add to /etc/security/limits.d/: @realtime - rtprio 99, and log in again",
        )
    elif fifo_priority:
        yield ok(check, f"fifo_priority {fifo_priority} is allowed")
    else:
        yield ok(check, f"not asked for (fifo_priority); up to {allowed} is allowed")


def _check_place(folder: Path) -> None:
    """Check that the folder exists or can be created on a writable disk; may raise OSError.

    An existing folder need not be writable: it may be of another user's daemon.
    """
    existing = _existing(folder)
    if not os.path.isdir(existing):
        raise OSError(errno.ENOTDIR, "is not a folder, nor a link to one", str(existing))
    if os.statvfs(existing).f_flag & os.ST_RDONLY:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(existing))
    if existing != folder and not os.access(existing, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "you may not write there", str(existing))


def _existing(path: Path) -> Path:
    """Return the path or its nearest existing parent; a dangling link counts as existing."""
    return next(each for each in (path, *path.parents) if os.path.lexists(each))


PINNED = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^]]*\])?==([^; ]+)")
"""Matches a requirement `NAME==VERSION`; the groups are the name and the version."""

WHEELS_FOR = "x86_64"


def check_wheels(
    requirements: Iterable[str] | None = None, version_of: Callable[[str], str] = metadata.version
) -> Iterator[Finding]:
    """Compare the installed ROS wheels with `requirements`, by default those of robotctl."""
    check = "wheels"
    if requirements is None:
        if platform.machine() != WHEELS_FOR:
            yield ok(
                check, f"there are none for {platform.machine()}: ROS is that of the workspace"
            )
            return
        try:
            requirements = metadata.requires("robotctl") or ()
        except metadata.PackageNotFoundError:
            yield ok(check, "robotctl was not installed by pip: its ROS is that of the workspace")
            return
    pinned = [
        match for each in requirements if "extra ==" not in each and (match := PINNED.match(each))
    ]
    wrong = []
    for name, wanted in (match.groups() for match in pinned):
        try:
            found = version_of(name)
        except metadata.PackageNotFoundError:
            wrong.append(f"{name} is missing")
            continue
        if found != wanted:
            wrong.append(f"{name} is {found} and not {wanted}")
    if wrong:
        cure = "install robotctl again in its environment: pip install --force-reinstall ."
        yield fault(check, "; ".join(wrong), cure)
    else:
        told = ", ".join(" ".join(match.groups()) for match in pinned)
        yield ok(check, f"{told}; Python {platform.python_version()}")


def check_shell(environment: Mapping[str, str], prefix: Path) -> Iterator[Finding]:
    """Warn if `environment` has paths of another ROS than the one in `prefix`."""
    check = "shell"
    paths = {name: value for name, value in environment.items() if name != "RMW_IMPLEMENTATION"}
    _, found = without_foreign_ros(paths, prefix)
    if found:
        yield warning(
            check,
            f"this shell has sourced another ROS, which robotctl avoids: it {found}",
            "start your own programs that use these wheels from a shell without it",
        )
    else:
        yield ok(check, "no other ROS precedes ours")


def check_two_rclpys(folders: Iterable[str]) -> Iterator[Finding]:
    """Warn if rclpy is in more than one of `folders`."""
    found = {
        (Path(folder) / "rclpy").resolve()
        for folder in folders
        if os.path.isfile(os.path.join(folder, "rclpy", "__init__.py"))  # False if we may not look
    }
    if len(found) > 1:
        yield warning(
            "rclpy",
            f"Python finds {len(found)} of them: {', '.join(sorted(map(str, found)))}",
            "use a virtual environment, or a shell without the other ROS",
        )


def check_pip(prefix: Path, base_prefix: Path, standard_library: Path) -> Iterator[Finding]:
    """Warn if the distribution does not allow pip for this Python (PEP 668)."""
    if prefix == base_prefix and (standard_library / "EXTERNALLY-MANAGED").exists():
        yield warning(
            "pip",
            f"{sys.executable} belongs to the distribution: pip install fails in it (PEP 668)",
            "make a virtual environment: python3 -m venv .venv && . .venv/bin/activate",
        )


SHARED_MEMORY: Final = Path("/dev/shm")

SETTLED_S: Final = 10.0
"""The age below which files are kept, as their process may not have locked them yet."""

SCARCE_SHARED_BYTES: Final = 16 << 20
"""Less free shared memory is a fault; a Fast DDS participant uses 0.6 MB, more for images."""

# A Fast DDS process locks `NAME_el` while it uses the memory `NAME`. Linux releases the lock when
# the process ends. Memory that another process maps is kept: that process may wait there.
_LOCKED = re.compile(r"fastrtps_(?:[0-9a-f]{16}|port\d+)_el")


def check_memory(folder: Path = SHARED_MEMORY) -> Iterator[Finding]:
    """Check the free shared memory, and report the files that dead processes have left."""
    check = "shared memory"
    try:
        found = os.statvfs(folder)
    except OSError as error:
        yield fault(check, f"{folder}: {error.strerror}", f"mount a tmpfs at {folder}")
        return
    free, size = found.f_bavail * found.f_frsize, found.f_blocks * found.f_frsize
    told = f"{free / 1e6:.0f} of {size / 1e6:.0f} MB free in {folder}"
    if not os.access(folder, os.W_OK | os.X_OK):
        yield fault(check, f"you may not write in {folder}", f"sudo chmod 1777 {folder}")
    elif free < SCARCE_SHARED_BYTES:
        cure = "clean it (robotctl doctor --clean), or give a container more: --shm-size 256m"
        yield fault(check, f"{told}: processes of ROS may not hear each other", cure)
    else:
        yield ok(check, told)
    left = stale(folder)
    if left:
        size = sum(path.stat().st_size for path in left if path.exists())
        yield warning(
            "dead processes",
            f"{len(left)} files in {folder} ({size / 1e6:.1f} MB) belong to no process any more",
            "remove them: robotctl doctor --clean",
        )


def stale(folder: Path = SHARED_MEMORY) -> list[Path]:
    """Return this user's shared memory files in `folder` that belong to dead processes."""
    try:
        names = [entry.name for entry in os.scandir(folder) if _LOCKED.fullmatch(entry.name)]
    except OSError:
        return []
    mapped = _mapped(folder)
    found: list[Path] = []
    for name in sorted(names):
        memory = name.removesuffix("_el")
        if memory not in mapped and name not in mapped and _is_free(folder / name):
            belonging = (memory, f"sem.{memory}_mutex", name)
            found += [folder / each for each in belonging if (folder / each).exists()]
    return found


def clean(folder: Path = SHARED_MEMORY) -> list[Path]:
    """Remove the files that `stale` finds in `folder`, and return the removed files."""
    removed = []
    for path in stale(folder):
        with suppress(FileNotFoundError):
            path.unlink()
            removed.append(path)
    return removed


def _is_free(path: Path) -> bool:
    """Return whether the lock file is ours, old, and not locked."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        facts = os.fstat(descriptor)
        if facts.st_uid != os.getuid() or time.time() - facts.st_ctime < SETTLED_S:
            return False
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # locked
        return False
    finally:
        os.close(descriptor)
    return True


def _mapped(folder: Path) -> set[str]:
    """Return the names of the files in `folder` that a process maps or has open, as /proc shows."""
    found: set[str] = set()
    for process in Path("/proc").iterdir():
        if not process.name.isdecimal():
            continue
        with suppress(OSError):  # it has ended, or is of another user
            found |= _names_below(folder, (process / "maps").read_text(errors="replace").split())
            links = [os.readlink(each) for each in (process / "fd").iterdir()]
            found |= _names_below(folder, links)
    return found


def _names_below(folder: Path, words: Iterable[str]) -> set[str]:
    start = f"{folder}/"
    return {word.removeprefix(start) for word in words if word.startswith(start)}


PROFILES: Final = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""The variable that names the profiles file for Fast DDS 2, the version in the wheels."""

LOCALHOST_ONLY: Final = "ROS_LOCALHOST_ONLY"
"""A variable of ROS Humble, whose value 1 overrules RANGE."""

MAX_PROFILES_BYTES: Final = 1_000_000

RANGES: Final = ("", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT", "OFF")


def check_middleware(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Warn if RMW_IMPLEMENTATION names another middleware than robotctl's."""
    given = environment.get("RMW_IMPLEMENTATION", "")
    if given not in ("", RMW):
        yield warning(
            "middleware",
            f"RMW_IMPLEMENTATION is {given}: robotctl uses {RMW}, the only one that it brings",
            f"let the nodes of the robot use the same: export RMW_IMPLEMENTATION={RMW}",
        )


def check_range(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Warn if the discovery range in `environment` is OFF, unknown to ROS, or overruled."""
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
    """Warn if Fast DDS cannot read the profiles file."""
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
    """Return the text of a file of a bounded size; may raise OSError."""
    with open_regular(path) as stream:
        data = stream.read(MAX_PROFILES_BYTES + 1)
    if len(data) > MAX_PROFILES_BYTES:
        raise OSError(f"{path} is larger than {MAX_PROFILES_BYTES / 1e6:.0f} MB")
    return data.decode(errors="replace")


ODOMETRY_TYPES: Final = (ODOMETRY,)
COMMAND_TYPES: Final = (TWIST, TWIST_STAMPED)

_UNMATCHED: Final = (
    ("reliability", "best_effort", "reliable"),
    ("durability", "volatile", "transient_local"),
)
"""For each QoS policy, an offered and a requested value that do not match."""

MAX_NAMED: Final = 5

MAX_ENDPOINTS: Final = 200


def check_command(topic: GraphTopic, *, has_odometry: bool) -> Iterator[Finding]:
    """Check the command topic; with `has_odometry`, a topic without subscribers is a fault."""
    yield from _check_topic("command", topic, COMMAND_TYPES)
    listeners = [each for each in topic["subscriptions"] if "/_" not in each["node"]]  # not hidden
    if has_odometry and not listeners:
        yield fault(
            "command",
            f"odometry arrives, but no node subscribes to {topic['name']}",
            "compare command.topic with the topic of the base: robotctl topic list -t",
        )
    if len(topic["publishers"]) > 1:
        yield warning(
            "command",
            f"{_names(topic['publishers'])} publish {topic['name']}: they overrule each other",
            "end all but one, or put a twist_mux between",
        )


def check_odometry(topic: GraphTopic) -> Iterator[Finding]:
    """Check the types and the QoS of the odometry topic, and that it has at most one publisher."""
    yield from _check_topic("odometry", topic, ODOMETRY_TYPES)
    if len(topic["publishers"]) > 1:
        yield fault(
            "odometry",
            f"{_names(topic['publishers'])} publish {topic['name']}: robotctl uses the first",
            "end all but one: a second driver, a simulator, or a bag that is played",
        )


def check_definitions(topics: Sequence[NameAndTypes]) -> Iterator[Finding]:
    """Report the topics with a message type that is not installed here."""
    from robotctl.messages.installed import NOT_INSTALLED, installed_type

    types = {kind: each["name"] for each in topics for kind in each["types"]}
    missing = {kind: types[kind] for kind in types if installed_type(kind) == NOT_INSTALLED}
    if missing:
        shown = [f"{kind} (of {name})" for kind, name in sorted(missing.items())]
        more = f" and {len(shown) - MAX_NAMED} more" if len(shown) > MAX_NAMED else ""
        yield warning(
            "message types",
            f"no definition here of {', '.join(shown[:MAX_NAMED])}{more}: they are not recorded",
            "install their packages, or source the workspace that has them",
        )
    else:
        yield ok("message types", f"every type of {len(topics)} topics is installed")


def _check_topic(check: str, topic: GraphTopic, wanted: tuple[str, ...]) -> Iterator[Finding]:
    publishers, subscriptions = topic["publishers"], topic["subscriptions"]
    if len(topic["types"]) > 1:
        users = [*publishers, *subscriptions]
        each_type = "; ".join(
            f"{kind} by {_names([each for each in users if each['type'] == kind])}"
            for kind in topic["types"]
        )
        cure = "give all of them one type, for the command by command.stamped"
        yield fault(check, f"{topic['name']} has several types, {each_type}", cure)
    elif topic["types"] and topic["types"][0] not in wanted:
        text = f"{topic['name']} has type {topic['types'][0]}, not {' or '.join(wanted)}"
        yield fault(check, text, f"set {check}.topic to the right topic")
    pairs = (
        _check_pair(check, topic["name"], publisher, subscription)
        for publisher in publishers[:MAX_ENDPOINTS]
        for subscription in subscriptions[:MAX_ENDPOINTS]
        if publisher["type"] == subscription["type"]
    )
    yield from islice(chain.from_iterable(pairs), MAX_NAMED)
    if publishers or subscriptions:
        counts = f"{len(publishers)} publishers, {len(subscriptions)} subscriptions"
        yield ok(check, f"{topic['name']} ({', '.join(topic['types'])}): {counts}")
    else:
        yield ok(check, f"no node uses {topic['name']} yet")


def _check_pair(
    check: str, topic: str, publisher: GraphEndpoint, subscription: GraphEndpoint
) -> Iterator[Finding]:
    for policy, offered, asked in _UNMATCHED:
        if publisher["qos"][policy] == offered and subscription["qos"][policy] == asked:
            yield fault(
                check,
                f"{_name(subscription)} hears nothing of {_name(publisher)} on {topic}: "
                f"{policy} {offered} is offered, {asked} asked for",
                f"let {_name(subscription)} ask for {offered}, or {_name(publisher)} offer {asked}",
            )


def _names(endpoints: Sequence[GraphEndpoint]) -> str:
    names = sorted({_name(each) for each in endpoints})
    more = [f"{len(names) - MAX_NAMED} more"] if len(names) > MAX_NAMED else []
    return " and ".join([*names[:MAX_NAMED], *more])


def _name(endpoint: GraphEndpoint) -> str:
    return endpoint["node"] or "a node without a known name"
