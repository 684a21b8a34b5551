"""SCHED_FIFO for the loop's thread, where it is permitted."""

from __future__ import annotations

import os
import threading


def check_priority(priority: int) -> None:
    """Check a SCHED_FIFO priority.

    Raises:
        ValueError: The priority is outside 1..99.
    """
    if not 1 <= priority <= 99:
        raise ValueError(f"a SCHED_FIFO priority must be 1 to 99, not {priority}")


class FifoScheduling:
    """Runs the calling thread under SCHED_FIFO until `restore`.

    Threads that it starts later do not inherit this: a DDS thread under SCHED_FIFO would delay
    the robot's other threads.
    """

    def __init__(self, priority: int) -> None:
        """Request SCHED_FIFO at `priority`, 1 (low) to 99; `description` says if it was granted.

        Raises:
            ValueError: The priority is outside 1..99.
        """
        check_priority(priority)
        self._former: tuple[int, os.sched_param] | None = None
        self._thread = threading.get_native_id()
        former = (os.sched_getscheduler(self._thread), os.sched_getparam(self._thread))
        try:
            os.sched_setscheduler(
                self._thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority)
            )
        except PermissionError:
            self.description = (
                f"SCHED_OTHER (SCHED_FIFO {priority} is not permitted: "
                "give the user an rtprio limit or the process CAP_SYS_NICE)"
            )
        else:
            self._former = former
            self.description = f"SCHED_FIFO {priority}"

    @property
    def granted(self) -> bool:
        """Whether the thread runs under SCHED_FIFO now."""
        return self._former is not None

    def restore(self) -> None:
        """Restore the thread's former scheduling; may be called from any thread."""
        if self._former is not None:
            policy, parameter = self._former
            self._former = None
            os.sched_setscheduler(self._thread, policy, parameter)
