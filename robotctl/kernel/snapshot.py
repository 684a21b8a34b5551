"""The snapshot of a kernel: every recording begins with one, so that it can be re-run."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A kernel between two events; `made_by` names the Python and libc that computed its floats."""

    made_by: str
    params: KernelParams
    state: State

    def kernel(self) -> Kernel:
        """Return a new kernel that continues from this snapshot."""
        return Kernel(self.params, self.state)
