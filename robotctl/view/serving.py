"""Runs one view: connects the ROS domain to the server, and ends both."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import sys
import time
from collections.abc import Callable, Coroutine
from contextlib import ExitStack
from typing import Any, Final
from urllib.parse import quote

from robotctl.base.own_process import end_signals
from robotctl.base.processes import pidfd_of
from robotctl.view.admission import Admission, new_token
from robotctl.view.server import ViewServer
from robotctl.view.view_job import ViewJob

_OUT_OF_DESCRIPTORS: Final = frozenset({errno.EMFILE, errno.ENFILE})

SAID_AGAIN_S: Final = 60.0
"""The least time between lines about a lack of descriptors; asyncio reports one each second."""


class LoopFailures:
    """Handles exceptions of the loop. While no descriptor is free, new viewers have to wait."""

    def __init__(self) -> None:
        self._said_s = -SAID_AGAIN_S

    def handle(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Print one line if no descriptor is free; leave any other failure to asyncio."""
        error = context.get("exception")
        if not isinstance(error, OSError) or error.errno not in _OUT_OF_DESCRIPTORS:
            loop.default_exception_handler(context)
        elif (now_s := time.monotonic()) - self._said_s >= SAID_AGAIN_S:
            self._said_s = now_s
            print(
                f"robotctl view: {error.strerror}: new viewers wait; raise the limit (ulimit -n), "
                "or close other viewers",
                file=sys.stderr,
                flush=True,
            )


Report = Callable[[dict[str, Any]], None]

NICENESS: Final = 5
"""On a busy computer the robot's processes have priority over the view."""

_STDIN: Final = 0
_WILDCARDS: Final = ("0.0.0.0", "::")


async def serve(job: ViewJob, report: Report, at_end: ExitStack) -> None:
    """Serve a view until a signal, the daemon's end or closed stdin; the caller closes `at_end`.

    Raises:
        RobotctlError: The view cannot be served; the text says why.
    """
    asyncio.get_running_loop().set_exception_handler(LoopFailures().handle)
    await Serving(job, report).show_domain(at_end)


class Serving:
    """Serves the view that a job describes, and reports the view's address and its end."""

    def __init__(self, job: ViewJob, report: Report) -> None:
        self._job = job
        self._report = report
        self._token = new_token()
        self._admission = Admission(self._token, job.origins, job.host)
        self._ended = end_signals()
        if not job.outlives_stdin:
            asyncio.get_running_loop().add_reader(_STDIN, self._end_with_stdin)

    async def show_domain(self, at_end: ExitStack) -> None:
        """Serve the topics of a domain until its daemon ends."""
        target = self._job.live
        os.nice(NICENESS)
        # After environment.prepare(), because they import rclpy.
        from robotctl.ros.session import ros_session
        from robotctl.view.live_view import LiveView

        server = self._controlled_server(target.robot)
        with pidfd_of(target.daemon_pid) as daemon:
            if daemon is not None:
                loop = asyncio.get_running_loop()
                loop.add_reader(daemon, self._end_with_daemon, loop, daemon, target.robot)
            async with ros_session(
                domain_id=target.domain_id, namespace=target.namespace, at_end=at_end
            ) as session:
                await self._run(server, LiveView(session, server).run())

    def _controlled_server(self, robot: str) -> ViewServer:
        """Return a server that gives viewers the control that the job allows."""
        name = f"robotctl: robot {robot}"
        if not self._job.control:
            return ViewServer(name, self._admission)
        from robotctl.view.remote_control import SERVICES, RemoteControl

        capabilities = ["services", *(["clientPublish"] if self._job.lease else [])]
        server = ViewServer(name, self._admission, capabilities=capabilities, services=SERVICES)
        RemoteControl(robot, server, self._job.lease)
        return server

    async def _run(self, server: ViewServer, feed: Coroutine[Any, Any, None]) -> None:
        """Run the server and its feed until one of them ends, or `_ended` is set."""
        work: list[asyncio.Future[Any]] = [asyncio.ensure_future(feed)]
        try:
            port = await server.listen(self._job.host, self._job.port)
            work += [asyncio.ensure_future(server.run()), asyncio.ensure_future(self._ended.wait())]
            self._report({"ready": self._address(port)})
            done, _ = await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            server.close()
            for task in work:
                task.cancel()
            await asyncio.gather(*work, return_exceptions=True)

    def _address(self, port: int) -> dict[str, Any]:
        """Return the URL to connect to, and the one that opens the desktop application."""
        host = socket.gethostname() if self._job.host in _WILDCARDS else self._job.host
        host = f"[{host}]" if ":" in host else host
        url = f"ws://{host}:{port}/?token={self._token}"
        opens = f"foxglove://open?ds=foxglove-websocket&ds.url={quote(url, safe='')}"
        return {"url": url, "open": opens, "port": port}

    def _end_with_stdin(self) -> None:
        asyncio.get_running_loop().remove_reader(_STDIN)
        self._ended.set()

    def _end_with_daemon(
        self, loop: asyncio.AbstractEventLoop, descriptor: int, robot: str
    ) -> None:
        loop.remove_reader(descriptor)
        self._report({"ended": f"the daemon of robot {robot!r} has ended"})
        self._ended.set()
