"""Runs one view, which offers the topics of a ROS domain through a `ViewServer`."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from robotctl.base.own_process import end_signals
from robotctl.base.processes import pidfd_of
from robotctl.view.server import ViewServer
from robotctl.view.view_job import ViewJob

if TYPE_CHECKING:
    from robotctl.ros.session import Session
from robotctl.view.viewer import Admission, new_token

_OUT_OF_DESCRIPTORS: Final = frozenset({errno.EMFILE, errno.ENFILE})

SAID_AGAIN_S: Final = 60.0
"""The least time between lines about a lack of descriptors."""


def loop_failures() -> Callable[[asyncio.AbstractEventLoop, dict[str, Any]], None]:
    """Return the loop's exception handler, which reports a lack of descriptors on stderr."""
    said_s = -SAID_AGAIN_S

    def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        nonlocal said_s
        error = context.get("exception")
        if not isinstance(error, OSError) or error.errno not in _OUT_OF_DESCRIPTORS:
            loop.default_exception_handler(context)
        elif (now_s := time.monotonic()) - said_s >= SAID_AGAIN_S:
            said_s = now_s
            print(
                f"robotctl view: {error.strerror}: new viewers wait; raise the limit (ulimit -n), "
                "or close other viewers",
                file=sys.stderr,
                flush=True,
            )

    return handle


Report = Callable[[dict[str, Any]], None]

NICENESS: Final = 5
"""The view's niceness, below the priority of the robot's processes."""

_STDIN: Final = 0
_WILDCARDS: Final = ("0.0.0.0", "::")


async def serve(job: ViewJob, report: Report, at_end: ExitStack) -> None:
    """Serve a live view until a signal, the daemon's end or closed stdin.

    Afterwards, the caller must close the stack `at_end`, which leaves the ROS domain.

    Raises:
        RobotctlError: The view cannot be served.
    """
    loop, target, token, ended = asyncio.get_running_loop(), job.live, new_token(), end_signals()
    loop.set_exception_handler(loop_failures())

    def end_with(descriptor: int) -> None:
        loop.remove_reader(descriptor)
        if descriptor != _STDIN:
            report({"ended": f"the daemon of robot {target.robot!r} has ended"})
        ended.set()

    if not job.outlives_stdin:
        loop.add_reader(_STDIN, end_with, _STDIN)
    os.nice(NICENESS)
    from robotctl.ros.session import ros_session  # after environment.prepare(): it imports rclpy

    server = _controlled_server(job, Admission(token, job.origins, job.host))
    with pidfd_of(target.daemon_pid) as daemon:
        if daemon is not None:
            loop.add_reader(daemon, end_with, daemon)
        async with ros_session(
            domain_id=target.domain_id, namespace=target.namespace, at_end=at_end
        ) as session:
            feed = asyncio.ensure_future(LiveView(session, server).run())
            work: list[asyncio.Future[Any]] = [feed]
            try:
                port = await server.listen(job.host, job.port)
                work += [asyncio.ensure_future(server.run()), asyncio.ensure_future(ended.wait())]
                report({"ready": _address(job.host, port, token)})
                done, _ = await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()
            finally:
                server.close()
                for task in work:
                    task.cancel()
                await asyncio.gather(*work, return_exceptions=True)


def _controlled_server(job: ViewJob, admission: Admission) -> ViewServer:
    """Return a server that gives viewers the control that the job allows."""
    name = f"robotctl: robot {job.live.robot}"
    if not job.control:
        return ViewServer(name, admission)
    from robotctl.view.remote_control import SERVICES, RemoteControl

    capabilities = ["services", *(["clientPublish"] if job.lease else [])]
    server = ViewServer(name, admission, capabilities=capabilities, services=SERVICES)
    RemoteControl(job.live.robot, server, job.lease)
    return server


def _address(host: str, port: int, token: str) -> dict[str, Any]:
    """Return the report `ready`, with a URL `open` for the desktop program."""
    host = socket.gethostname() if host in _WILDCARDS else host
    host = f"[{host}]" if ":" in host else host
    url = f"ws://{host}:{port}/?token={token}"
    opens = f"foxglove://open?ds=foxglove-websocket&ds.url={quote(url, safe='')}"
    return {"url": url, "open": opens, "port": port}


_NODE: Final = "_view"
"""The node's name, hidden from ROS tools by its underscore."""


class LiveView:
    """Offers the topics of a domain to viewers, and sends messages of the watched topics."""

    def __init__(self, session: Session, server: ViewServer) -> None:
        from robotctl.ros.tap.on_demand import OnDemandTap

        self._server = server
        self._channels: dict[str, int] = {}
        self._topics: dict[int, str] = {}
        self._tap = OnDemandTap(session.node(_NODE), self)
        server.on_subscribed = self._subscribed
        server.on_unwatched = self._unwatched

    async def run(self) -> None:
        """Follow the graph until cancelled."""
        await self._tap.run()

    # From the tap

    def appeared(self, topic: str, type_name: str, definition: str) -> None:
        """Offer a topic that the tap has found."""
        channel_id = self._server.offer(topic, type_name, definition)
        self._channels[topic] = channel_id
        self._topics[channel_id] = topic

    def vanished(self, topic: str) -> None:
        """Withdraw a topic that has left the graph."""
        channel_id = self._channels.pop(topic)
        del self._topics[channel_id]
        self._server.withdraw(channel_id)

    def unusable(self, topic: str, problem: str) -> None:
        """Show viewers the note `problem` on a topic that is not offered; "" removes the note."""
        self._server.note(topic, problem)

    # From the server

    def _subscribed(self, channel_id: int) -> None:
        """Subscribe to the topic anew, so that each viewer gets the latched messages."""
        self._tap.want(self._topics[channel_id], partial(self._forward, channel_id))

    def _unwatched(self, channel_id: int) -> None:
        topic = self._topics.get(channel_id)
        if topic is not None:
            self._tap.unwant(topic)

    def _forward(
        self, channel_id: int, data: bytes | memoryview, received_ns: int, *_: object
    ) -> None:
        self._server.publish(channel_id, received_ns, data)
