"""Everything that is needed to decide the rest again: it opens every recording."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A kernel at rest between two events; `made_by` names what its floats depend on."""

    made_by: str
    params: KernelParams
    state: State

    def kernel(self) -> Kernel:
        """Return a fresh kernel that goes on from here."""
        return Kernel(self.params, self.state)
