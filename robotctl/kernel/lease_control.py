"""The part of the kernel that decides on the lease."""

from __future__ import annotations

from dataclasses import replace

from robotctl.kernel.lease import Lease, LeaseLost, LeaseRequested, MotionRequest
from robotctl.kernel.mode_control import ModeControl
from robotctl.kernel.modes import Mode
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.types import Phase


class LeaseControl(ModeControl):
    """The decisions on the lease; while the robot moves, its motion is that of the holder."""

    def _request_lease(self, event: LeaseRequested) -> None:
        lease = self.state.lease
        if not event.take and lease is None:
            self._accept(event.request_id, "Nobody holds the lease")
        elif lease is not None and (event.take or event.client != lease.client):
            self._refuse_for(lease, event)
        elif not event.take:
            self._end_lease(f"{event.source} released the lease")
            self._accept(event.request_id, "Lease released")
        elif self.state.mode is Mode.MOVING:
            self._refuse(event.request_id, "the robot is MOVING", (Remedy.STOP_FIRST,))
        else:
            taken = Lease(event.client, event.source, event.reason)
            self.state = replace(self.state, lease=taken)
            self._accept(event.request_id, "Lease taken")

    def _lose_lease(self, event: LeaseLost) -> None:
        lease = self.state.lease
        if lease is not None and lease.client == event.client:
            self._end_lease(f"{lease.source} lost the lease: {event.how}")

    def _end_lease(self, reason: str) -> None:
        """Ramp down: after this, no client may steer."""
        state = replace(self.state, lease=None)
        if state.mode is Mode.MOVING:
            stop_reason = state.stop_reason or reason
            state = replace(state, phase=Phase.STOPPING, stop_reason=stop_reason)
        self.state = state

    def _is_kept_by_another(self, event: MotionRequest) -> bool:
        """Refuse a request for motion if another client holds the lease; return whether it does."""
        lease = self.state.lease
        if lease is None or lease.client == event.client:
            return False
        self._refuse_for(lease, event)
        return True

    def _refuse_for(self, lease: Lease, event: MotionRequest) -> None:
        why = f" ({lease.reason})" if lease.reason else ""
        refusal = f"{lease.source} holds the lease{why}, and {event.source} asked"
        self._refuse(event.request_id, refusal, (Remedy.WAIT_FOR_LEASE,))
