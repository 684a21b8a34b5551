"""The methods for the lease, whose holder alone may start and steer motion."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass
from typing import Any

from robotctl.base.errors import Refused
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.daemon.control.dispatcher import Control, granted
from robotctl.ipc.answers import LeaseKept, LeaseStatus, MessageAnswer
from robotctl.ipc.method_names import LEASE_KEEP, LEASE_RELEASE, LEASE_STATUS, LEASE_TAKE
from robotctl.ipc.method_params import (
    LeaseKeepParams,
    LeaseReleaseParams,
    LeaseStatusParams,
    LeaseTakeParams,
)
from robotctl.ipc.server import Method
from robotctl.kernel.types import LeaseLost, LeaseRequested

NOBODY = 0
"""The client number of a request that does not have the token of the present lease."""

LISTEN_S = 0.25
"""How often [s] to check whether the holder of the lease has called `lease_keep`."""

SILENT_PERIODS = 4
"""The lease ends after this many periods of LISTEN_S without a `lease_keep` of its holder."""


@dataclass(slots=True)
class _Holder:
    """A client that requested the lease."""

    client: int
    token: str
    ended: asyncio.Future[str]
    was_heard: bool = False


class LeaseMethods:
    """The handlers of the lease's methods.

    A lease ends by its release, with its connection, or after SILENT_PERIODS without a
    `lease_keep`.
    """

    def __init__(
        self, control: Control, robot: str = DEFAULT_ROBOT, listen_s: float = LISTEN_S
    ) -> None:
        self._control = control
        self._robot = robot
        self._listen_s = listen_s
        self._clients = NOBODY
        self._holder: _Holder | None = None

    def table(self) -> dict[str, Method[Any]]:
        """Return every method by its name."""
        return {
            LEASE_TAKE: Method(LeaseTakeParams, self._take, None),
            LEASE_KEEP: Method(LeaseKeepParams, self._keep),
            LEASE_RELEASE: Method(LeaseReleaseParams, self._release),
            LEASE_STATUS: Method(LeaseStatusParams, self._status),
        }

    def client_of(self, token: str | None) -> int:
        """Return the number of the lease's holder if `token` is the lease's token, else NOBODY."""
        holder = self._holder
        return holder.client if holder is not None and holder.token == token else NOBODY

    async def _take(self, params: LeaseTakeParams) -> MessageAnswer:
        self._clients += 1
        ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        holder = _Holder(self._clients, params.token, ended)
        event = LeaseRequested(
            *self._control.stamp(), True, holder.client, params.source, params.reason
        )
        try:
            granted(await self._control.request(event), self._robot)
            self._holder = holder
            await self._until_silent(holder)
        except asyncio.CancelledError:
            self._control.dispatch(LeaseLost(time.monotonic_ns(), holder.client))
            raise
        finally:
            if self._holder is holder:
                self._holder = None
        if ended.done():
            return {"message": ended.result()}
        how = f"nothing was heard from it for {SILENT_PERIODS * self._listen_s:g} s"
        self._control.dispatch(LeaseLost(time.monotonic_ns(), holder.client, how))
        raise Refused(f"{params.source} lost the lease: {how}", "take it again")

    async def _until_silent(self, holder: _Holder) -> None:
        """Wait until the lease is released, or SILENT_PERIODS pass without a `lease_keep`."""
        silent = 0  # in periods, not seconds: a stall of the loop must not end the lease
        while silent < SILENT_PERIODS and not holder.ended.done():
            holder.was_heard = False
            await asyncio.wait({holder.ended}, timeout=self._listen_s)
            silent = 0 if holder.was_heard else silent + 1

    async def _keep(self, params: LeaseKeepParams) -> LeaseKept:
        holder = self._holder
        is_yours = holder is not None and holder.token == params.token
        if holder is not None and is_yours:
            holder.was_heard = True
        return {"yours": is_yours}

    async def _release(self, params: LeaseReleaseParams) -> MessageAnswer:
        holder = self._holder
        client = self.client_of(params.token)
        event = LeaseRequested(*self._control.stamp(), False, client, params.source)
        answer = granted(await self._control.request(event), self._robot)
        if holder is not None and holder.client == client and not holder.ended.done():
            holder.ended.set_result(f"Lease released by {params.source}")
        return {"message": answer["message"]}

    async def _status(self, params: LeaseStatusParams) -> LeaseStatus:
        lease = self._control.state.lease
        return {
            "holder": None if lease is None else lease.source,
            "reason": "" if lease is None else lease.reason,
            "yours": lease is not None and lease.client == self.client_of(params.token),
        }
