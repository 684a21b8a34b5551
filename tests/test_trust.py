"""Only this user and root can replace the daemon's files or answer in its place."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from robotctl.base.errors import Refused, UsageError
from robotctl.base.paths import chain_to, latch_path, make_private, runtime_folder, socket_path
from robotctl.cli import app
from robotctl.daemon.control.latch import Latch
from robotctl.ipc.client import call
from robotctl.ipc.protocol import Peer
from robotctl.replay.replay_guard import running_daemons
from tests.support.users import as_root
from tests.support.waiting import DEADLINE_S

STRANGER = 65533
"""A second user."""


@pytest.fixture
def base(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Make the folder of XDG_RUNTIME_DIR, with `state` for XDG_STATE_HOME; others may read it."""
    folder = Path(tempfile.mkdtemp(prefix="rt-", dir="/tmp"))
    folder.chmod(0o755)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    (folder / "state").mkdir(mode=0o755)
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def tmp_base(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Make the folder of sockets without XDG_RUNTIME_DIR, below a /tmp that is open to everyone."""
    tmp = Path(tempfile.mkdtemp(prefix="rt-", dir="/tmp"))
    tmp.chmod(0o1777)
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("robotctl.base.paths.SHARED_FOLDER", tmp)
    yield tmp / f"robotctl-{os.getuid()}"
    shutil.rmtree(tmp)


class Impostor:
    """Answers every request with success, and keeps the requests."""

    def __init__(self, path: Path) -> None:
        self.received = b""
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        path.chmod(0o666)
        self._listener.listen()
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                sock, _ = self._listener.accept()
                with sock:
                    data = sock.recv(65536)
                    self.received += data
                    for line in data.splitlines():
                        result = {"protocol": 1, "message": "Mode changed to EMERGENCY_STOP"}
                        reply = {"jsonrpc": "2.0", "id": json.loads(line)["id"], "result": result}
                        sock.sendall(json.dumps(reply).encode() + b"\n")

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)  # `accept` returns
        self._listener.close()


@contextmanager
def another_user(uid: int = STRANGER) -> Iterator[None]:
    """Let files and sockets that the block creates belong to another user."""
    os.setegid(uid)
    os.seteuid(uid)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(0)


@as_root
def test_a_folder_that_another_user_created_first_is_not_trusted(
    tmp_base: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They create /tmp/robotctl-UID, let us create the rest in it, and replace that later."""
    with another_user():
        tmp_base.mkdir(mode=0o755)
    ours = tmp_base / "robotctl"
    ours.mkdir(mode=0o700)
    with another_user():
        ours.rename(tmp_base / "swapped")
        ours.mkdir(mode=0o755)
        impostor = Impostor(ours / "robot.sock")
    try:
        exit_code = app.run(["estop"])
    finally:
        impostor.close()
    out, err = capsys.readouterr()
    assert (exit_code, out) == (2, "")
    assert err == (
        f"robotctl: {tmp_base} belongs to uid {STRANGER}: "
        "set XDG_RUNTIME_DIR to a folder of yours\n"
    )
    assert impostor.received == b""
    with pytest.raises(UsageError, match="belongs to uid"):
        make_private(runtime_folder())  # as every daemon does that starts
    with pytest.raises(UsageError, match="belongs to uid"):
        running_daemons()


@as_root
def test_a_strangers_server_is_sent_nothing(base: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_private(runtime_folder())
    impostor = _impostor_process(socket_path("robot"))
    try:
        exit_code = app.run(["estop"])
        said = impostor.communicate(timeout=DEADLINE_S)[0]
    finally:
        impostor.kill()
        impostor.wait()
    out, err = capsys.readouterr()
    assert (exit_code, out) == (4, "")
    assert err == (
        f"robotctl: the process at {socket_path('robot')} belongs to uid {STRANGER}, neither "
        f"you nor root: nothing was sent (see which it is: ps -fp {impostor.pid})\n"
    )
    assert said == b"received: b''\n"


def _impostor_process(path: Path) -> subprocess.Popen[bytes]:
    """Start a process of another user that listens at `path` and prints what its client sends."""
    code = (
        "import os, socket, sys\n"
        "sock = socket.socket(socket.AF_UNIX)\n"
        "sock.bind(sys.argv[1])\n"
        f"os.setresuid({STRANGER}, {STRANGER}, {STRANGER})\n"
        "sock.listen()\n"  # the credentials that SO_PEERCRED tells are those of now
        "print(flush=True)\n"
        "print('received:', sock.accept()[0].recv(65536), flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    return process


@pytest.mark.parametrize("mode", [0o700, 0o755, 0o775, 0o2775, 0o1777])
def test_a_folder_of_ours_that_others_cannot_change_is_used(base: Path, mode: int) -> None:
    base.chmod(mode)
    folder = make_private(runtime_folder())
    assert folder.stat().st_mode & 0o777 == 0o700
    chain_to(folder).check()


def test_a_folder_that_every_user_can_write_to_is_refused_with_the_cure(base: Path) -> None:
    folder = make_private(runtime_folder())
    base.chmod(0o777)
    for check in (chain_to(folder).check, lambda: make_private(folder)):
        with pytest.raises(UsageError) as caught:
            check()
        assert str(caught.value) == f"{base} can be written by every user: chmod o-w {base}"
    os.chmod(base, base.stat().st_mode & ~0o002)
    make_private(folder)


def test_a_folder_that_a_group_can_write_to_is_used_and_said(base: Path) -> None:
    chain = chain_to(make_private(runtime_folder()))
    assert chain.group_writable() == []
    base.chmod(0o775)
    os.chown(base, -1, _a_group_of_ours(base))
    (said,) = chain.group_writable()
    assert said.startswith(f"{base} can be written by group ")
    assert said.endswith(f"chmod g-w {base})")


def _a_group_of_ours(base: Path) -> int:
    groups = [gid for gid in (*os.getgroups(), STRANGER) if gid != os.getuid()]
    if os.getuid() != 0 and len(groups) == 1:
        pytest.skip("this user has one group only")
    return groups[0]


@as_root
@pytest.mark.parametrize("depth", [0, 1, 2])
def test_no_folder_of_the_chain_belongs_to_another_user(base: Path, depth: int) -> None:
    path = latch_path("robot")
    make_private(path.parent)
    theirs = (*reversed(path.parents[:3]),)[depth]
    os.chown(theirs, STRANGER, STRANGER)
    for check in (Latch(path).read, lambda: make_private(path.parent)):
        with pytest.raises(UsageError) as caught:
            check()
        cure = "set XDG_STATE_HOME to a folder of yours"
        assert str(caught.value) == f"{theirs} belongs to uid {STRANGER}: {cure}"


@pytest.mark.parametrize("name", ["robotctl", "robotctl/robot"])
def test_no_link_is_followed_below_the_base(base: Path, name: str) -> None:
    elsewhere = base / "elsewhere"
    (elsewhere / "robot").mkdir(parents=True)
    link = base / "state" / name
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(elsewhere)
    path = latch_path("robot")
    for check in (Latch(path).read, lambda: make_private(path.parent)):
        with pytest.raises(UsageError, match=f"{link} is a link of uid {os.getuid()}"):
            check()


def test_a_base_may_be_a_link_of_ours(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (base / "real").mkdir()
    (base / "link").symlink_to("real")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base / "link"))
    make_private(runtime_folder())
    assert (base / "real" / "robotctl").is_dir()


@as_root
def test_a_base_that_is_a_link_of_another_user_is_refused(
    base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (base / "real").mkdir()
    (base / "link").symlink_to("real")
    os.chown(base / "link", STRANGER, STRANGER, follow_symlinks=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base / "link"))
    with pytest.raises(UsageError, match=f"{base / 'link'} is a link of uid {STRANGER}"):
        call("robot", "status")


def test_something_else_in_the_place_of_a_folder_is_named(base: Path) -> None:
    (base / "robotctl").touch()
    with pytest.raises(UsageError, match=f"{base / 'robotctl'} is not a folder: set XDG_RUNTIME_D"):
        call("robot", "status")


def test_missing_folders_are_created_for_this_user_alone_under_any_umask(
    base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(base / "home" / ".local" / "state"))
    folder = latch_path("robot").parent
    before = os.umask(0)
    try:
        make_private(folder)
    finally:
        os.umask(before)
    for path in (folder, *folder.parents[:4]):
        assert path.stat().st_mode & 0o777 == 0o700, path


@as_root
def test_a_folder_that_cannot_be_created_is_named_with_the_cure(
    base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After su, XDG_RUNTIME_DIR is still that of the previous user."""
    with another_user(), pytest.raises(UsageError) as caught:
        make_private(runtime_folder())
    assert str(caught.value) == (
        f"{base / 'robotctl'} cannot be created: Permission denied: "
        "set XDG_RUNTIME_DIR to a folder of yours"
    )
    assert caught.value.cure == "set XDG_RUNTIME_DIR to a folder of yours"


def test_ourselves_and_root_may_answer(base: Path) -> None:
    chain = chain_to(runtime_folder())
    assert chain.trusts(os.getuid())
    assert chain.trusts(0)
    assert not chain.trusts(STRANGER)


@as_root
def test_root_may_stop_the_robot_of_a_user_whose_folder_it_names(
    base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """sudo -E keeps XDG_RUNTIME_DIR; without the variable, no user is named."""
    os.chown(base, STRANGER, STRANGER)
    chain = chain_to(runtime_folder())
    assert chain.for_client().trusts(STRANGER)
    assert not chain.for_client().trusts(STRANGER - 1)
    chain.for_client().check()
    with pytest.raises(UsageError, match="belongs to uid"):
        make_private(runtime_folder())  # but it starts no daemon there
    monkeypatch.setattr("os.getuid", lambda: 1000)
    assert not chain.for_client().trusts(STRANGER)
    monkeypatch.undo()
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert not chain.for_client().trusts(STRANGER)


def test_a_user_whom_a_container_does_not_know_is_refused_and_told_so(
    base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        make_private(runtime_folder())
        listener.bind(str(socket_path("robot")))
        listener.listen()
        monkeypatch.setattr("robotctl.ipc.client.peer_of", lambda _: Peer(0, 65534, 65534))
        with pytest.raises(Refused, match="a user that this container does not know"):
            call("robot", "status")


def test_a_server_of_ours_is_trusted(base: Path) -> None:
    make_private(runtime_folder())
    impostor = Impostor(socket_path("robot"))
    try:
        assert call("robot", "status")["protocol"] == 1
    finally:
        impostor.close()
