"""Which requests on ROS come from another host, by the gids of their clients."""

from __future__ import annotations

from robotctl.base.domains import is_on_this_machine_only
from robotctl.ros.executor import requester

HOST = slice(4)
"""The part of a gid of Fast DDS that names vendor and host; processes of one host share it."""


class RemoteRequests:
    """Compares the client of the present request with a gid of this process.

    The host part has two bytes, and a client could send any gid: this prevents mistakes, not
    attacks.
    """

    def __init__(self, own_gid: bytes) -> None:
        self._host = own_gid[HOST]

    def is_remote(self) -> bool:
        """Return whether the request that is handled now may come from another host.

        A client of another host is not kept away by the range LOCALHOST of this process: it needs
        only to name this machine as a static peer. An unknown client may be remote where discovery
        is not limited to this machine.
        """
        gid = requester()
        if gid is None:
            return not is_on_this_machine_only()
        return gid[HOST] != self._host
