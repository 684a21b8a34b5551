"""Ranking a thread that works in the background below those that somebody waits for."""

from __future__ import annotations

import ctypes
import os
import platform
from contextlib import suppress
from typing import Final

SLICE_NS: Final = 20_000_000
"""Since Linux 6.12 a thread that wakes up displaces one whose slice is longer than its own, which
is 3 ms unless it asks for another; the end of a shorter one it has to wait for."""

_SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274}
"""The number of the system call; no library wraps it."""


class _Attributes(ctypes.Structure):
    """`struct sched_attr`, its first version; sched_setattr(2)."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        ("runtime", ctypes.c_uint64),
        ("deadline", ctypes.c_uint64),
        ("period", ctypes.c_uint64),
    )


def rank_below(nice: int) -> None:
    """Let the calling thread, and it alone, displace no other and be displaced by any that wakes.

    Its share, where all cores are busy, is that of its niceness, `nice` more than before.
    """
    os.nice(nice)
    with suppress(OSError):  # a container may forbid it
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    number = _SCHED_SETATTR.get(platform.machine())
    if number is None:
        return
    attributes = _Attributes(
        size=ctypes.sizeof(_Attributes),
        policy=os.SCHED_BATCH,
        nice=os.getpriority(os.PRIO_PROCESS, 0),
        runtime=SLICE_NS,
    )
    ctypes.CDLL(None).syscall(number, 0, ctypes.byref(attributes), 0)  # a kernel may not know it
