"""Guarded motion: another node wants velocities, and the kernel limits them and may stop them."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from robotctl.kernel.types import ZERO, Twist
from robotctl.kernel.units import NS_PER_S


@dataclass(frozen=True, slots=True)
class Guarded:
    """A guarded motion, with the last wanted velocity; `t_ns` is None before the first one."""

    twist: Twist = ZERO
    t_ns: int | None = None

    def wanted(self, t_ns: int, timeout_s: float) -> Twist | None:
        """Return the wanted velocity, None if it is not finite or older than the timeout."""
        if self.t_ns is None or abs(t_ns - self.t_ns) / NS_PER_S > timeout_s:
            return None
        twist = self.twist
        return twist if isfinite(twist.linear) and isfinite(twist.angular) else None
