"""A reply of the kernel, as the answer to a client or as the error that it gets."""

from __future__ import annotations

from robotctl.daemon.control.pending_requests import UnsavedReply
from robotctl.errors import Refused, RobotctlError
from robotctl.ipc.advice import advice
from robotctl.ipc.answers import ModeAnswer
from robotctl.kernel.types import Reply


def granted(reply: Reply, robot: str) -> ModeAnswer:
    """Return the answer to a request that was granted; the cures in errors name `robot`.

    Raises:
        Refused: The kernel refused it.
        RobotctlError: It is done, but could not be saved.
    """
    if isinstance(reply, UnsavedReply):
        raise RobotctlError(*advice(reply.message, reply.remedies, robot))
    if not reply.ok:
        raise Refused(*advice(reply.message, reply.remedies, robot))
    return {"message": reply.message, "mode": reply.mode.name}
