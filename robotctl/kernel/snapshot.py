"""The snapshot of a kernel: every recording begins with one, so that it can be re-run."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State


@dataclass(frozen=True, slots=True)
class Proof:
    """What was sent and written before a snapshot, so that a check finds what is missing.

    `commands` is the number of velocity commands that were sent, `journal_crc` the CRC-32 of all
    journal entries in their serialized form.
    """

    commands: int
    journal_crc: int


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A kernel between two events; `made_by` names the Python and libc that computed its floats.

    `proof` is None in a recording of version 0.1.0.
    """

    made_by: str
    params: KernelParams
    state: State
    proof: Proof | None = None

    def kernel(self) -> Kernel:
        """Return a new kernel that continues from this snapshot."""
        return Kernel(self.params, self.state)
