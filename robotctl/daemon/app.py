"""The composition root: makes every part, connects them, and owns every task."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import signal
import time
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from functools import partial
from math import nan
from shutil import rmtree
from typing import Any

from robotctl import __version__
from robotctl.config import Config, load
from robotctl.daemon.control import Control
from robotctl.daemon.effects import Effects
from robotctl.daemon.ending import stand_still, until
from robotctl.daemon.inputs import Inputs
from robotctl.daemon.journal import Journal
from robotctl.daemon.latch import Latch
from robotctl.daemon.methods import Methods
from robotctl.daemon.neighbours import is_alone, somebody_is_driven, watch_publishers
from robotctl.daemon.options import DaemonOptions
from robotctl.daemon.recordings import open_recorder, tidy
from robotctl.daemon.requests import Requests
from robotctl.daemon.status import StatusSource, discovery_range
from robotctl.daemon.supervisor import Supervisor, Work
from robotctl.daemon.watchdog import Watchdog
from robotctl.errors import RobotctlError
from robotctl.ipc.server import ControlServer, Identity
from robotctl.kernel.kernel import Kernel, State, latched
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import ZERO, DriveRequested, Tick
from robotctl.paths import latch_path, log_path, socket_path
from robotctl.recording.recorder import Topic
from robotctl.ros import qos
from robotctl.ros.battery_subscriber import BatterySubscriber
from robotctl.ros.journal_publisher import JournalPublisher
from robotctl.ros.mode_service import ModeService, Shown
from robotctl.ros.odom_subscriber import OdomSubscriber
from robotctl.ros.raw import UNKNOWN_GID, Sink
from robotctl.ros.session import Session, ros_session
from robotctl.ros.simulated_robot import SimulatedRobot
from robotctl.ros.tap import Tap, TappedTopic
from robotctl.ros.ticker import Ticker
from robotctl.ros.velocity_publisher import VelocityPublisher

_log = logging.getLogger(__name__)

READY_S = 3.0
"""How long a start waits for the first odometry and battery level of a robot that is there."""

DRAIN_S = 1.0
"""How long a stop waits for the recorder to see the last command."""

STATUS_PERIOD_S = 1.0

Ready = Callable[[dict[str, Any]], None]


async def serve(options: DaemonOptions, notes: list[str], on_ready: Ready) -> None:
    """Run the daemon until it is told to stop; `on_ready` is called once with the summary.

    The caller owns the robot's lock. Raises RobotctlError where it cannot start.
    """
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    config = load(options.config) if options.config is not None else Config()
    address = socket_path(options.robot)
    alone = is_alone(options.domain_id)
    supervisor = Supervisor()
    loop.set_exception_handler(supervisor.loop_failed)
    async with AsyncExitStack() as stack:
        latch = Latch(latch_path(options.robot))
        stack.push_async_callback(latch.close)
        session = await stack.enter_async_context(
            ros_session(
                domain_id=options.domain_id,
                namespace=options.namespace,
                on_exception=supervisor.callback_failed,
                fifo_priority=config.fifo_priority or None,
            )
        )
        notes = [*notes, *await asyncio.to_thread(tidy, options.recordings, config.recording)]
        daemon = _Daemon(options, config, latch, session, supervisor, stop)
        stack.push_async_callback(daemon.close_recorder)
        identity = Identity(options.robot, __version__, os.getpid())
        server = ControlServer(address, daemon.methods.table(), identity)
        try:
            stack.enter_context(server)
        except BaseException:
            await daemon.discard_recording()
            raise
        try:
            await daemon.run(server, notes, on_ready, alone=alone)
        except BaseException:
            await daemon.cut_command()
            raise


class _Daemon:
    """Every part, made in the order of dependence; nothing is published before it is recorded."""

    def __init__(
        self,
        options: DaemonOptions,
        config: Config,
        latch: Latch,
        session: Session,
        supervisor: Supervisor,
        stop: asyncio.Event,
    ) -> None:
        self._options = options
        self._config = config
        self._session = session
        self._supervisor = supervisor
        self._stop = stop
        params = config.kernel
        self._recorder = open_recorder(
            options.recordings,
            options.robot,
            config,
            _in_loop(lambda detail: self._inputs.recorder_failed(detail)),
            _in_loop(lambda path: self._inputs.file_begun(path)),
        )
        journal_publisher = JournalPublisher(session)
        self._tap = Tap(session, self._open_sink, skip=frozenset({journal_publisher.topic}))
        self._tap.subscribe_own(params.command.topic, "geometry_msgs/msg/Twist", qos.COMMAND)
        self._tap.subscribe_own("robot_status", "robot_controller/msg/RobotStatus", qos.LATCHED)
        self._velocity = VelocityPublisher(session, params.command.topic)
        requests = Requests()
        reason = latch.read()
        self._control = Control(
            Kernel(params, State() if reason is None else latched(reason)),
            Journal(self._open_journal(journal_publisher)),
            Effects(self._velocity.publish, self._show_mode, latch, requests).carry_out,
            requests,
            supervisor.callback_failed,
        )
        supervisor.report_to(self._control.dispatch)
        self._status = StatusSource(
            options, self._control, self._recorder, self._tap, params, session.scheduling
        )
        self._inputs = Inputs(self._control, self._status, self._velocity)
        self._watchdog = Watchdog(
            params.rate_hz, params.max_tick_gap_s, self._velocity, _in_loop(self._stalled)
        )
        self._odometry = OdomSubscriber(session, params.odometry.topic, self._inputs.odometry)
        if params.battery.topic:
            BatterySubscriber(session, params.battery.topic, self._inputs.battery)
        self._modes = ModeService(session, options.robot, self._inputs.service_call)
        self.methods = Methods(self._control, self._status, params, stop)

    async def run(
        self, server: ControlServer, notes: list[str], on_ready: Ready, *, alone: bool
    ) -> None:
        """Run every task until the daemon is told to stop."""
        gc.collect()
        gc.freeze()  # a full collection over all that was imported would hold the loop for 70 ms
        self._control.journal_snapshot(time.monotonic_ns())
        sim = self._options.sim
        if sim is None:
            sim = alone or not await somebody_is_driven(self._odometry, self._stop)
            if not sim:
                notes = [*notes, f"no simulator: {self._odometry.topic} has a publisher already"]
        self._status.sim = sim
        async with asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(self._supervisor.run(name, work))
                for name, work in self._work(server, sim).items()
            ]
            with self._watchdog:
                ready = await self._become_ready(notes, on_ready)
                await self._stop.wait()
                _log.info("stopping")
                await stand_still(self._control)
            for task in tasks:
                task.cancel()
        await until(self._is_drained, DRAIN_S)
        if not ready:
            raise RobotctlError("the daemon was told to stop before it was ready")

    async def cut_command(self) -> None:
        """Send a zero past everything else, and record it: the daemon is about to fail."""
        try:
            self._velocity.publish(ZERO)
            await until(self._is_drained, DRAIN_S)
        except Exception:  # noqa: BLE001 - what made the daemon fail is to be told, not this
            _log.exception("no last zero could be sent")

    async def close_recorder(self) -> None:
        """Finish the recording; the disk is not waited for in the loop."""
        stats = await asyncio.to_thread(self._recorder.close)
        _log.info(
            "recorded %d messages in %s, %d dropped, %d lost",
            stats.written,
            stats.file,
            stats.dropped,
            stats.lost,
        )

    async def discard_recording(self) -> None:
        """Leave nothing behind of a start that failed before anything ran."""
        stats = await asyncio.to_thread(self._recorder.close)
        await asyncio.to_thread(rmtree, stats.file.parent, ignore_errors=True)

    # Tasks

    def _work(self, server: ControlServer, sim: bool) -> dict[str, Work]:
        work: dict[str, Work] = {
            "control": self._tick,
            "recorder": self._tap.run,
            "publisher watch": partial(watch_publishers, self._velocity, self._control.dispatch),
            "status": self._show_status,
            "socket": server.serve,
        }
        if sim:
            work["simulated robot"] = self._simulated_robot().run
        return work

    def _simulated_robot(self) -> SimulatedRobot:
        params = self._config.kernel
        self._tap.subscribe_own(params.odometry.topic, "nav_msgs/msg/Odometry", qos.SENSOR)
        if params.battery.topic:
            self._tap.subscribe_own(
                params.battery.topic, "sensor_msgs/msg/BatteryState", qos.SENSOR
            )
        return SimulatedRobot(
            self._session,
            self._config.sim,
            command_topic=params.command.topic,
            odometry_topic=params.odometry.topic,
            battery_topic=params.battery.topic,
        )

    async def _tick(self) -> None:
        async for tick in Ticker(self._config.kernel.rate_hz):
            self._control.dispatch(Tick(tick.t_ns, tick.missed))
            self._watchdog.ping()

    async def _show_status(self) -> None:
        while True:
            self._show_mode(self._control.state.mode)
            self._status.sample()
            await asyncio.sleep(STATUS_PERIOD_S)

    def _show_mode(self, mode: Mode) -> None:
        level = self._control.state.health.battery_level
        self._modes.publish(
            Shown(mode, nan if level is None else level, self._status.is_connected())
        )

    def _stalled(self, detail: str) -> None:
        self._inputs.stalled(detail)
        self._watchdog.taken()

    # The recording

    def _open_sink(self, topic: TappedTopic) -> Sink:
        return partial(self._recorder.write, self._recorder.add_topic(_recorded(topic)))

    def _open_journal(self, publisher: JournalPublisher) -> Callable[[bytes, int], None]:
        channel = self._recorder.add_topic(_recorded(publisher.description))

        def write_entry(serialized: bytes, seq: int) -> None:
            now_ns = time.time_ns()
            self._recorder.write(channel, serialized, now_ns, now_ns, seq + 1, UNKNOWN_GID)
            publisher.publish(serialized)

        return write_entry

    def _is_drained(self) -> bool:
        received = {topic.name: topic.received for topic in self._recorder.stats().topics}
        return (
            received.get(self._velocity.topic, 0) >= self._velocity.published
            and received.get(self._modes.status_topic, 0) >= self._modes.published
        )

    # Beginning

    async def _become_ready(self, notes: list[str], on_ready: Ready) -> bool:
        if self._status.sim or self._odometry.count_publishers():
            await until(lambda: self._is_connected() or self._stop.is_set(), READY_S)
        if self._stop.is_set():
            return False
        if self._options.drive is not None:
            notes = [*notes, await self._begin_drive()]
        on_ready(self._summary(notes))
        _log.info("ready")
        return True

    def _is_connected(self) -> bool:
        known = self._control.state.health.battery_level is not None
        return self._status.is_connected() and (known or not self._config.kernel.battery.topic)

    async def _begin_drive(self) -> str:
        pattern = self.methods.pattern(self._options.drive)
        request_id = self._control.new_request_id()
        reply = await self._control.request(
            DriveRequested(
                time.monotonic_ns(), request_id, pattern, 0, False, "robotctl start --drive"
            )
        )
        return reply.message

    def _summary(self, notes: list[str]) -> dict[str, Any]:
        return {
            "ready": True,
            "robot": self._options.robot,
            "mode": self._control.state.mode.name,
            "domain_id": self._options.domain_id,
            "discovery_range": discovery_range(),
            "sim": self._status.sim,
            "socket": str(socket_path(self._options.robot)),
            "recording": str(self._recorder.stats().file),
            "log": str(log_path(self._options.robot)),
            "pid": os.getpid(),
            "notes": notes,
        }


def _recorded(topic: TappedTopic) -> Topic:
    return Topic(topic.name, topic.type_name, topic.definition, topic.type_hash, topic.offered_qos)


def _in_loop(call: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return what any thread may call to have `call` called in the loop."""
    loop = asyncio.get_running_loop()

    def post(argument: Any) -> None:
        with suppress(RuntimeError):  # the loop is closed: nobody is left to tell
            loop.call_soon_threadsafe(call, argument)

    return post
