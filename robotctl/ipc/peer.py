"""The process at the other end of a Unix socket, as the Linux kernel knows it."""

from __future__ import annotations

import os
import socket
import struct
from typing import Final, NamedTuple

from robotctl.trust import ROOT_UID

_UCRED = struct.Struct("iII")

SO_PEERGROUPS: Final = 59
"""Of asm-generic/socket.h; Python does not name it."""

_GROUPS_BYTES: Final = 1024
"""The most that `getsockopt` of Python takes: 256 groups."""


class Peer(NamedTuple):
    """The struct ucred of unix(7), from connect or listen; pid 0 for another pid namespace."""

    pid: int
    uid: int
    gid: int


def peer_of(sock: socket.socket) -> Peer:
    """Return the process at the other end of a connected socket."""
    raw = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
    return Peer(*_UCRED.unpack(raw))


def groups_of(sock: socket.socket) -> frozenset[int]:
    """Return the groups of the process at the other end, as far as Linux tells them."""
    primary = peer_of(sock).gid
    try:
        raw = sock.getsockopt(socket.SOL_SOCKET, SO_PEERGROUPS, _GROUPS_BYTES)
    except OSError:  # more than 256 groups
        return frozenset((primary,))
    return frozenset((primary, *struct.unpack(f"{len(raw) // 4}I", raw)))


def guest_of(sock: socket.socket) -> int | None:
    """Return the uid of the process at the other end; None for this user and root."""
    uid = peer_of(sock).uid
    return None if uid in (ROOT_UID, os.getuid()) else uid
