"""What is wrong with the computer is named; what is in order gives no false alarm.

Settings of the middleware that do not do what they seem to do are named; others are not.
What keeps command and odometry from arriving is read from the graph.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import resource
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robotctl import doctor as machine
from robotctl.base.environment import RMW
from robotctl.base.paths import runtime_folder, state_folder
from robotctl.doctor import (
    MAX_NAMED,
    Finding,
    Level,
    check_command,
    check_definitions,
    check_middleware,
    check_odometry,
    check_profiles,
    check_range,
    check_shell,
)
from robotctl.ipc.answers import GraphEndpoint, GraphTopic, NameAndTypes
from tests.support.users import as_root, process_of

MEMORY = "fastrtps_0123456789abcdef"
PORT = "fastrtps_port7411"


def levels(found: Iterator[Finding]) -> list[tuple[str, Level]]:
    return [(each.check, each.level) for each in found]


@pytest.fixture
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The shared memory of two dead processes, and files of other programs."""
    monkeypatch.setattr(machine, "SETTLED_S", 0.0)
    for name in (MEMORY, f"{MEMORY}_el", PORT, f"{PORT}_el", f"sem.{PORT}_mutex"):
        (tmp_path / name).write_bytes(b"x" * 4096)
    for name in ("fastrtps_port7000", "pulse-shm-1", "fastrtps_x_el", "sem.other_mutex"):
        (tmp_path / name).write_bytes(b"y")
    return tmp_path


def stale(folder: Path) -> set[str]:
    return {path.name for path in machine.stale(folder)}


def test_memory_of_dead_processes_is_removed_and_nothing_else(memory: Path) -> None:
    found = list(machine.check_memory(memory))
    assert ("dead processes", Level.WARNING) in levels(iter(found))
    assert len(machine.clean(memory)) == 5
    assert stale(memory) == set()
    left = {path.name for path in memory.iterdir()}
    assert left == {"fastrtps_port7000", "pulse-shm-1", "fastrtps_x_el", "sem.other_mutex"}
    assert "dead processes" not in dict(levels(machine.check_memory(memory)))


@pytest.mark.parametrize("kind", [fcntl.LOCK_EX, fcntl.LOCK_SH])
def test_memory_whose_owner_lives_is_left(kind: int, memory: Path) -> None:
    outside = os.open(memory / f"{MEMORY}_el", os.O_RDONLY)
    fcntl.flock(outside, kind)
    assert not {name for name in stale(memory) if name.startswith(MEMORY)}
    os.close(outside)
    assert MEMORY in stale(memory)


def test_memory_that_a_neighbour_has_mapped_is_left(memory: Path) -> None:
    with (memory / PORT).open("r+b") as stream, mmap.mmap(stream.fileno(), 0):
        stream.close()
        assert stale(memory) == {MEMORY, f"{MEMORY}_el"}


def test_a_file_that_was_just_made_is_left(memory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "SETTLED_S", 3600.0)
    assert stale(memory) == set()


@pytest.mark.skipif(os.getuid() != 0, reason="needs root")
def test_memory_of_another_user_is_left(memory: Path) -> None:
    os.chown(memory / f"{MEMORY}_el", 65534, 65534)
    assert not {name for name in stale(memory) if name.startswith(MEMORY)}


def test_a_link_in_the_place_of_a_lock_is_not_followed(memory: Path, tmp_path: Path) -> None:
    (memory / f"{MEMORY}_el").unlink()
    (memory / f"{MEMORY}_el").symlink_to("/etc/passwd")
    assert MEMORY not in stale(memory)


def test_shared_memory_that_is_not_there_is_a_fault(tmp_path: Path) -> None:
    assert levels(machine.check_memory(tmp_path / "none")) == [("shared memory", Level.FAULT)]


def test_the_wheels_have_exactly_the_versions_that_are_required() -> None:
    wanted = ["ros-a[x]==1.2; m == 'y'", "free>=2", "ros-t==9 ; extra == 'test'", "ros-b==3"]
    versions = {"ros-a": "1.2", "ros-b": "3"}
    assert levels(machine.check_wheels(wanted, versions.__getitem__)) == [("wheels", Level.OK)]
    (found,) = machine.check_wheels(wanted, {**versions, "ros-b": "4"}.__getitem__)
    assert found.level is Level.FAULT
    assert found.text == "ros-b is 4 and not 3"
    assert levels(machine.check_wheels()) == [("wheels", Level.OK)], "as installed here"


def test_another_ros_in_the_shell_and_a_second_rclpy_are_named(tmp_path: Path) -> None:
    ours, other = tmp_path / "venv", tmp_path / "humble"
    for folder in (ours, other):
        (folder / "rclpy").mkdir(parents=True)
        (folder / "rclpy" / "__init__.py").touch()
    environment = {"PYTHONPATH": str(other), "ROS_DISTRO": "humble"}
    assert levels(machine.check_shell(environment, ours)) == [("shell", Level.WARNING)]
    assert levels(machine.check_shell({}, ours)) == [("shell", Level.OK)]
    twice = [str(ours), str(other), str(ours), ""]
    assert levels(machine.check_two_rclpys(twice)) == [("rclpy", Level.WARNING)]
    assert levels(machine.check_two_rclpys([str(ours), str(ours)])) == []


@as_root
def test_a_python_path_in_the_home_of_another_user_ends_no_check(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    hidden = str(tmp_path / "site-packages")
    imports = "from pathlib import Path\nfrom robotctl import doctor as checks"
    code = f"""
for variable in ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH"):
    print(*checks.check_shell({{variable: {hidden!r}}}, Path("/venv")))
print(*checks.check_two_rclpys([{hidden!r}]))
"""
    out, err = process_of(1234, [], imports, code, os.environ).communicate(timeout=30.0)
    assert err == ""
    assert out.count("no other ROS precedes ours") == 3


def test_a_python_of_the_distribution_is_named_outside_an_environment(tmp_path: Path) -> None:
    usr, venv = Path("/usr"), Path("/venv")
    assert levels(machine.check_pip(usr, usr, tmp_path)) == []
    (tmp_path / "EXTERNALLY-MANAGED").touch()
    assert levels(machine.check_pip(usr, usr, tmp_path)) == [("pip", Level.WARNING)]
    assert levels(machine.check_pip(venv, usr, tmp_path)) == []


def test_a_disk_that_is_full_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "not" / "yet"
    assert levels(machine.check_disk(folder))[0][0] == "disk"
    monkeypatch.setattr(machine, "SCARCE_BYTES", 1 << 62)
    assert levels(machine.check_disk(folder)) == [("disk", Level.WARNING)]
    monkeypatch.setattr(machine, "FULL_BYTES", 1 << 62)
    assert levels(machine.check_disk(folder)) == [("disk", Level.FAULT)]


@pytest.mark.parametrize("kind", ["file", "FIFO", "link to nothing", "link to itself"])
def test_a_place_for_recordings_that_is_no_folder_is_a_fault(kind: str, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    make: dict[str, Callable[[], None]] = {
        "file": folder.touch,
        "FIFO": lambda: os.mkfifo(folder),
        "link to nothing": lambda: folder.symlink_to(tmp_path / "nowhere"),
        "link to itself": lambda: folder.symlink_to(folder),
    }
    make[kind]()
    (found,) = machine.check_disk(folder)
    assert found.level is Level.FAULT
    assert found.text == f"{folder} is not a folder, nor a link to one"


def test_a_folder_of_another_user_is_a_fault_unless_that_users_daemon_records_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert levels(machine.check_disk(tmp_path)) == [("disk", Level.FAULT)]
    (found,) = machine.check_disk(tmp_path, is_used=True)
    assert "GB free for recordings" in found.text


def test_a_clock_that_was_never_set_or_set_back_is_named(tmp_path: Path) -> None:
    (tmp_path / "latch").touch()
    now_s = (tmp_path / "latch").stat().st_mtime
    assert levels(machine.check_clock(now_s, tmp_path)) == [("clock", Level.OK)]
    assert levels(machine.check_clock(now_s - 3600.0, tmp_path)) == [("clock", Level.WARNING)]
    assert levels(machine.check_clock(1_000.0, tmp_path / "none")) == [("clock", Level.FAULT)]


def test_a_folder_open_to_all_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    folder = tmp_path / "state" / "robotctl"
    folder.mkdir(parents=True, mode=0o700)
    assert levels(machine.check_folders(folder)) == [("permissions", Level.OK)]
    folder.chmod(0o777)
    (found,) = machine.check_folders(folder)
    assert found.level is Level.FAULT
    assert found.cure == f"chmod o-w {folder}"
    shutil.rmtree(folder)


@pytest.mark.parametrize("variable", ["XDG_RUNTIME_DIR", "XDG_STATE_HOME"])
@pytest.mark.parametrize("place", ["file/below", "nothing", "locked/below"])
def test_a_folder_that_cannot_be_created_is_a_fault(
    place: str, variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "file").touch()
    (tmp_path / "nothing").symlink_to(tmp_path / "nowhere")
    (tmp_path / "locked").mkdir()
    real = os.access  # root may write everywhere
    monkeypatch.setattr(os, "access", lambda path, mode: path.name != "locked" and real(path, mode))
    monkeypatch.setenv(variable, str(tmp_path / place))
    (found,) = machine.check_folders(runtime_folder(), state_folder())
    assert found.level is Level.FAULT
    assert str(tmp_path / place.partition("/")[0]) in found.text
    assert found.cure == f"set {variable} to a folder of yours"


def test_a_priority_beyond_the_limit_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 1000)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (10, 10))
    assert levels(machine.check_priority(0)) == [("rtprio", Level.OK)]
    assert levels(machine.check_priority(10)) == [("rtprio", Level.OK)]
    assert levels(machine.check_priority(11)) == [("rtprio", Level.WARNING)]


@pytest.mark.parametrize(
    ("limit", "level"),
    [
        (127, Level.FAULT),
        (128, Level.WARNING),
        (255, Level.WARNING),
        (256, Level.OK),
        (resource.RLIM_INFINITY, Level.OK),
    ],
)
def test_a_limit_of_open_files_that_a_daemon_may_reach_is_named(
    limit: int, level: Level, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (limit, limit))
    assert levels(machine.check_descriptors()) == [("open files", level)]


PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"


def only(found: list[Finding]) -> Finding:
    (one,) = found
    assert one.level is Level.WARNING
    assert one.cure
    return one


def test_another_middleware_is_named_and_is_no_other_ros() -> None:
    environment = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    assert "RMW_IMPLEMENTATION is rmw_cyclonedds_cpp" in only([*check_middleware(environment)]).text
    assert [each.level for each in check_shell(environment, Path("/venv"))] == [Level.OK]
    for given in ({}, {"RMW_IMPLEMENTATION": ""}, {"RMW_IMPLEMENTATION": RMW}):
        assert [*check_middleware(given)] == []


@pytest.mark.parametrize(
    ("discovery", "localhost_only", "text"),
    [
        ("subnet", "0", "'subnet', which ROS does not know: it takes LOCALHOST"),
        ("OFF", "0", "no process discovers another"),
        ("SUBNET", "1", "overrules ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET"),
    ],
)
def test_a_range_hiding_processes_is_named(discovery: str, localhost_only: str, text: str) -> None:
    environment = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery,
        "ROS_LOCALHOST_ONLY": localhost_only,
    }
    assert text in only([*check_range(environment)]).text


def test_a_profiles_file_that_has_no_effect_is_named(tmp_path: Path) -> None:
    file = tmp_path / "fast.xml"
    environment = {PROFILES: str(file)}
    assert "No such file" in only([*check_profiles(environment)]).text
    file.write_text("profiles: yes")
    assert "it is no XML" in only([*check_profiles(environment)]).text
    file.write_text("<dds><profiles/></dds>")
    assert [*check_profiles(environment)] == []
    assert [*check_profiles({})] == []
    os.mkfifo(tmp_path / "pipe")
    for no_file in ("", str(tmp_path), str(tmp_path / "pipe"), "/dev/zero"):
        assert only([*check_profiles({PROFILES: no_file})]).check == "profiles"


TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
ODOMETRY = "nav_msgs/msg/Odometry"


def endpoint(
    node: str, kind: str, reliability: str = "reliable", durability: str = "volatile"
) -> GraphEndpoint:
    qos: dict[str, str | int] = {"reliability": reliability, "durability": durability, "depth": 1}
    return {"node": node, "type": kind, "gid": "1", "qos": qos}


def topic(
    name: str, publishers: list[GraphEndpoint], subscriptions: list[GraphEndpoint]
) -> GraphTopic:
    types = sorted({each["type"] for each in (*publishers, *subscriptions)})
    return {
        "name": name,
        "types": types,
        "publishers": publishers,
        "subscriptions": subscriptions,
    }


def command_faults(found: GraphTopic, *, has_odometry: bool = True) -> list[str]:
    findings = check_command(found, has_odometry=has_odometry)
    return [each.text for each in findings if each.level is not Level.OK]


def test_a_healthy_graph_and_an_empty_one_give_no_alarm() -> None:
    command = topic("/cmd_vel", [endpoint("/daemon", TWIST)], [endpoint("/base", TWIST)])
    odometry = topic(
        "/odom", [endpoint("/base", ODOMETRY)], [endpoint("/daemon", ODOMETRY, "best_effort")]
    )
    assert command_faults(command) == []
    assert command_faults(topic("/cmd_vel", [], []), has_odometry=False) == []
    assert [each.level for each in check_odometry(odometry)] == [Level.OK]
    assert [each.level for each in check_odometry(topic("/odom", [], []))] == [Level.OK]


@pytest.mark.parametrize(
    ("publishers", "subscriptions", "text"),
    [
        ([endpoint("/daemon", TWIST)], [], "no node subscribes to /cmd_vel"),
        ([], [endpoint("/_recorder", TWIST)], "no node subscribes to /cmd_vel"),
        (
            [endpoint("/daemon", TWIST)],
            [endpoint("/base", STAMPED)],
            f"several types, {TWIST} by /daemon; {STAMPED} by /base",
        ),
        ([], [endpoint("/base", "std_msgs/msg/String")], "has type std_msgs/msg/String, not"),
        (
            [endpoint("/nav", TWIST), endpoint("/joy", TWIST)],
            [endpoint("/base", TWIST)],
            "/joy and /nav publish /cmd_vel",
        ),
        (
            [endpoint("/nav", TWIST, "best_effort")],
            [endpoint("/base", TWIST)],
            "/base hears nothing of /nav on /cmd_vel: reliability best_effort is offered",
        ),
        (
            [endpoint("/nav", TWIST)],
            [endpoint("/base", TWIST, durability="transient_local")],
            "durability volatile is offered, transient_local asked for",
        ),
    ],
)
def test_what_keeps_a_command_from_arriving_is_named(
    publishers: list[GraphEndpoint], subscriptions: list[GraphEndpoint], text: str
) -> None:
    (found,) = command_faults(topic("/cmd_vel", publishers, subscriptions))
    assert text in found


def test_a_flood_of_endpoints_gives_a_few_findings_at_once() -> None:
    weak = [endpoint(f"/p{number}", TWIST, "best_effort") for number in range(5_000)]
    strong = [endpoint(f"/s{number}", TWIST) for number in range(5_000)]
    found = command_faults(topic("/cmd_vel", weak, strong))
    assert len(found) == MAX_NAMED + 1
    assert max(map(len, found)) < 300


def test_two_sources_of_odometry_are_a_fault() -> None:
    twice = [endpoint("/base", ODOMETRY), endpoint("/bag", ODOMETRY)]
    found = [each for each in check_odometry(topic("/odom", twice, [])) if each.cure]
    assert [each.text for each in found] == [
        "/bag and /base publish /odom: robotctl uses the first"
    ]


def test_types_without_a_definition_are_named_up_to_a_number() -> None:
    types = [*map("far/msg/T{}".format, range(8)), ODOMETRY]
    topics = [NameAndTypes(name=f"/t{at}", types=[kind]) for at, kind in enumerate(types)]
    (found,) = check_definitions(topics)
    assert "far/msg/T0 (of /t0)" in found.text
    assert "and 3 more" in found.text
    (fine,) = check_definitions(topics[-1:])
    assert fine.level is Level.OK
