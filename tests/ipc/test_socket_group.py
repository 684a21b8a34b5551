"""`socket.group`: who may connect, whom a member trusts, and what is refused at the start."""

from __future__ import annotations

import grp
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotctl.base.errors import UsageError
from robotctl.ipc.listener import SocketGroup, socket_group
from robotctl.ipc.server import ControlServer
from tests.ipc.conftest import IDENTITY
from tests.support.users import as_root, process_of
from tests.support.waiting import DEADLINE_S, until

OWNER, MEMBER, STRANGER = 65501, 65502, 65503
ROBOTS = SocketGroup("robots", 65510)
OTHERS = SocketGroup("others", 65511)

SERVER_IMPORTS = """
import asyncio
from robotctl.ipc.server import Method
from robotctl.ipc.method_params import ResetParams
from robotctl.ipc.server import Identity
from robotctl.ipc.server import ControlServer
from robotctl.ipc.listener import SocketGroup
from robotctl.base.paths import socket_path
"""

SERVER = """
async def reset(params):
    return {"message": params.source, "mode": "IDLE"}

async def serve():
    group, identity = SocketGroup("robots", 65510), Identity("robot", "0.1.0", os.getpid())
    methods = {"reset": Method(ResetParams, reset)}
    with ControlServer(socket_path("robot"), methods, identity, group=group) as server:
        print("listens", flush=True)
        await server.serve()

asyncio.run(serve())
"""

CLIENT_IMPORTS = """
import robotctl.base.trust
from pathlib import Path
from robotctl.base.errors import RobotctlError
from robotctl.ipc.client import call
robotctl.base.trust.SYSTEM_RUNTIME = Path(os.environ["UNITS"])
"""

CLIENT = """
try:
    print(call("robot", "reset", {"source": "robotctl reset (uid 0, pid 1)"})["message"])
except RobotctlError as error:
    print(f"{error.exit_code}: {error}")
"""


@pytest.fixture
def base() -> Iterator[Path]:
    """The folder that root has made for a unit of OWNER, in one as /run is."""
    units = Path(tempfile.mkdtemp(prefix="units-", dir="/tmp"))
    units.chmod(0o755)
    made = units / "robotctl-robot"
    made.mkdir()
    made.chmod(0o711)
    os.chown(made, OWNER, OWNER)
    yield made
    shutil.rmtree(units)


def environment(base: Path) -> dict[str, str]:
    return {**os.environ, "XDG_RUNTIME_DIR": str(base), "UNITS": str(base.parent)}


@pytest.fixture
def served(base: Path) -> Iterator[Path]:
    """The socket of a server of OWNER that the group may use."""
    server = process_of(OWNER, [ROBOTS.gid], SERVER_IMPORTS, SERVER, environment(base))
    assert server.stdout is not None
    assert server.stdout.readline() == "listens\n", server.communicate()[1]
    yield base / "robotctl" / "robot.sock"
    server.kill()
    server.communicate(timeout=DEADLINE_S)


def asked(uid: int, groups: list[int], base: Path) -> str:
    """Return the answer to a reset, or the error."""
    client = process_of(uid, groups, CLIENT_IMPORTS, CLIENT, environment(base))
    out, err = client.communicate(timeout=DEADLINE_S)
    assert err == ""
    return out.rstrip("\n")


@as_root
def test_a_member_gives_commands_and_others_do_not(base: Path, served: Path) -> None:
    for path, mode in ((served, 0o660), (served.parent, 0o750)):
        found = path.stat()
        assert (stat.S_IMODE(found.st_mode), found.st_uid, found.st_gid) == (mode, OWNER, 65510)
    assert asked(OWNER, [], base) == "robotctl reset (uid 0, pid 1)"
    told = asked(MEMBER, [ROBOTS.gid], base)
    assert told == f"robotctl reset (uid 0, pid 1) of uid {MEMBER}", "whatever the member claims"
    assert asked(STRANGER, [OTHERS.gid], base) == f"4: {served} belongs to another user"


@as_root
def test_where_a_stranger_reaches_the_socket_the_server_refuses_it(
    base: Path, served: Path
) -> None:
    served.parent.chmod(0o755)
    served.chmod(0o666)
    told = asked(STRANGER, [OTHERS.gid], base)
    assert told == f"4: robot 'robot' belongs to uid {OWNER}, not {STRANGER}"


@as_root
@pytest.mark.parametrize("flaw", ["another place", "another name", "writable by all"])
def test_a_member_trusts_a_folder_only_if_root_alone_can_have_made_it(
    flaw: str, base: Path, served: Path
) -> None:
    variables = environment(base)
    match flaw:
        case "another place":
            variables["UNITS"] = "/run"
        case "another name":
            moved = base.rename(base.with_name("user"))
            variables["XDG_RUNTIME_DIR"] = str(moved)
        case _:
            base.parent.chmod(0o1777)
    client = process_of(MEMBER, [ROBOTS.gid], CLIENT_IMPORTS, CLIENT, variables)
    out, _ = client.communicate(timeout=DEADLINE_S)
    assert out.startswith(f"2: {variables['XDG_RUNTIME_DIR']} belongs to uid {OWNER}")


@as_root
def test_a_member_sends_nothing_to_a_process_of_a_third_user(base: Path) -> None:
    folder = base / "robotctl"
    folder.mkdir()
    folder.chmod(0o777)
    imports = "import socket"
    code = f"""
os.umask(0)
sock = socket.socket(socket.AF_UNIX)
sock.bind({str(folder / "robot.sock")!r})
sock.listen()
print("listens", flush=True)
print(sock.accept()[0].recv(65536), flush=True)
"""
    impostor = process_of(STRANGER, [ROBOTS.gid], imports, code, os.environ)
    try:
        assert impostor.stdout is not None
        assert impostor.stdout.readline() == "listens\n"
        os.chown(folder, OWNER, ROBOTS.gid)
        folder.chmod(0o750)
        told = asked(MEMBER, [ROBOTS.gid], base)
        assert f"belongs to uid {STRANGER}, neither you nor root: nothing was sent" in told
        assert impostor.communicate(timeout=DEADLINE_S)[0] == "b''\n"
    finally:
        impostor.kill()
        impostor.wait()


def test_a_group_that_does_not_exist_is_refused_by_name() -> None:
    with pytest.raises(UsageError) as caught:
        socket_group("no_such_group")
    assert str(caught.value) == (
        "socket.group: there is no group 'no_such_group': make it: sudo groupadd no_such_group"
    )
    assert socket_group("") is None


def test_a_group_without_the_user_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    known = grp.getgrgid(0).gr_name
    monkeypatch.setattr(os, "geteuid", lambda: STRANGER)
    monkeypatch.setattr(os, "getegid", lambda: STRANGER)
    monkeypatch.setattr(os, "getgroups", list)
    with pytest.raises(UsageError) as caught:
        socket_group(known)
    assert str(caught.value).startswith(
        f"socket.group: user '{STRANGER}' is not in group {known!r}: sudo usermod -aG {known} "
    )
    monkeypatch.setattr(os, "getgroups", lambda: [0])
    assert socket_group(known) == SocketGroup(known, 0)


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def a_group_of_ours() -> SocketGroup:
    return SocketGroup(grp.getgrgid(os.getegid()).gr_name, os.getegid())


def test_without_a_group_the_folder_is_private_again(path: Path) -> None:
    path.parent.parent.chmod(0o711)
    with ControlServer(path, {}, IDENTITY, group=a_group_of_ours()):
        assert (mode_of(path), mode_of(path.parent)) == (0o660, 0o750)
    with ControlServer(path, {}, IDENTITY):
        assert (mode_of(path), mode_of(path.parent)) == (0o600, 0o700)


def test_a_second_robot_does_not_close_the_folder_to_the_group_of_the_first(path: Path) -> None:
    path.parent.parent.chmod(0o711)
    second = path.with_name("second.sock")
    with ControlServer(path, {}, IDENTITY, group=a_group_of_ours()):
        with ControlServer(second, {}, IDENTITY):
            assert (mode_of(second), mode_of(path.parent)) == (0o600, 0o750)
        another = SocketGroup("another", os.getegid() + 1)
        with (
            pytest.raises(UsageError, match="is open to group"),
            ControlServer(second, {}, IDENTITY, group=another),
        ):
            pass
        assert not second.exists()


def test_a_folder_that_the_group_cannot_reach_is_refused_with_the_cure(path: Path) -> None:
    path.parent.parent.chmod(0o700)
    with (
        pytest.raises(UsageError) as caught,
        ControlServer(path, {}, IDENTITY, group=SocketGroup("another", os.getegid() + 1)),
    ):
        pass
    assert str(caught.value) == (
        f"socket.group: {path.parent.parent} is closed to group 'another': "
        "start the daemon by a unit: sudo robotctl boot install --system"
    )
    assert not path.exists()


@as_root
def test_a_socket_that_was_removed_is_made_again_for_the_group(base: Path, served: Path) -> None:
    served.unlink()
    until(served.exists)
    until(lambda: mode_of(served) == 0o660)
    assert "of uid" in asked(MEMBER, [ROBOTS.gid], base)


SEEN = """
print(names(), dead_robots(), [each.level.value for each in check_folders(runtime_folder())])
"""

SEEN_IMPORTS = """
import robotctl.base.trust
from pathlib import Path
from robotctl.cli.commands.doctor import dead_robots
from robotctl.cli.targets.robots import names
from robotctl.doctor import check_folders
from robotctl.base.errors import Refused
from robotctl.base.paths import runtime_folder
robotctl.base.trust.SYSTEM_RUNTIME = Path(os.environ["UNITS"])
"""


@as_root
def test_a_member_finds_the_robot_and_the_doctor_nothing_wrong(base: Path, served: Path) -> None:
    served.with_suffix(".lock").touch(mode=0o600)  # as the daemon does, which a member cannot open
    member = process_of(MEMBER, [ROBOTS.gid], SEEN_IMPORTS, SEEN, environment(base))
    out, err = member.communicate(timeout=DEADLINE_S)
    assert (out, err) == ("['robot'] [] ['ok']\n", "")


@as_root
def test_a_stranger_is_told_that_it_may_not_see_which_robots_there_are(
    base: Path, served: Path
) -> None:
    code = "try:\n    names()\nexcept Refused as error:\n    print(error)"
    stranger = process_of(STRANGER, [], SEEN_IMPORTS, code, environment(base))
    out, _ = stranger.communicate(timeout=DEADLINE_S)
    assert out == f"{served.parent} belongs to another user\n"
