"""Lower the scheduling priority of a background thread."""

from __future__ import annotations

import ctypes
import os
import platform
from contextlib import suppress
from typing import Final

SLICE_NS: Final = 20_000_000
"""Time slice of the thread. Since Linux 6.12 a waking thread preempts one with a longer slice than
its own (3 ms by default), and waits for the end of a shorter one."""

_SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274}
"""Number of the system call, which no library wraps."""


class _Attributes(ctypes.Structure):
    """`struct sched_attr`, first version; see sched_setattr(2)."""

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
    """Let the calling thread preempt no other thread, and be preempted by each that wakes.

    When all cores are busy, its share of CPU time is that of its niceness, increased by `nice`.
    Other threads are not affected.
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
