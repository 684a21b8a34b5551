"""The daemon that drives a robot, and records the whole ROS graph."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from robotctl.base.errors import RobotctlError
from robotctl.base.paths import latch_path
from robotctl.daemon.api.driving import DrivingMethods
from robotctl.daemon.api.lease import LeaseMethods
from robotctl.daemon.api.parameters import parameter_methods
from robotctl.daemon.api.recording import recording_methods
from robotctl.daemon.api.simulation import simulation_methods
from robotctl.daemon.api.status import StatusSource, common_methods, graph_methods
from robotctl.daemon.control.decisions import Decisions
from robotctl.daemon.control.dispatcher import Control, Journal, PendingRequests
from robotctl.daemon.control.effects import Effects
from robotctl.daemon.control.inputs import Inputs, has_odometry_publisher, watch_graph
from robotctl.daemon.control.latch import Latch
from robotctl.daemon.control.robot_report import GroundTruth, RobotReport
from robotctl.daemon.control.watchdog import Watchdog
from robotctl.daemon.control_loop import ControlLoop, urgent_event
from robotctl.daemon.diagnostics import Diagnostics
from robotctl.daemon.drive_goals import DriveGoals
from robotctl.daemon.host import Host, Ready, running
from robotctl.daemon.input_roles import create_input_roles
from robotctl.daemon.last_zero import LastZero
from robotctl.daemon.node_lifecycle import follow_lifecycle, with_lifecycle
from robotctl.daemon.parameters import Parameters
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.remote_requests import RemoteRequests
from robotctl.daemon.ros_parameters import serve_parameters
from robotctl.daemon.shown_status import ShownStatus
from robotctl.daemon.shutdown import send_zero, stand_still
from robotctl.daemon.simulator import recorded_robot
from robotctl.daemon.supervisor import Work
from robotctl.daemon.waiting import until
from robotctl.ipc.advice import advice
from robotctl.ipc.request_handler import Method
from robotctl.ipc.server import ControlServer
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.state import State, latched
from robotctl.kernel.types import Odometry, Reply
from robotctl.ros.messages.command_type import CommandType
from robotctl.ros.messages.qos import ODOMETRY
from robotctl.ros.nodes.drive_action import DriveAction
from robotctl.ros.nodes.mode_service import CALLS, STATUS, ModeService
from robotctl.ros.nodes.odom_subscriber import OdomSubscriber
from robotctl.ros.nodes.publishers import CommandLock, JournalPublisher
from robotctl.ros.nodes.simulated_robot import SimulatedRobot
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher, command_topic

_log = logging.getLogger(__name__)

READY_S = 10.0
"""How long a start waits for what the configuration expects: odometry, battery level, and a
subscriber of the command. Discovery by Fast DDS takes up to 2.6 s; a robot may still boot."""


class Driver:
    """A daemon that connects kernel, ROS roles and recorder."""

    def __init__(self, host: Host, command: CommandType) -> None:
        self._host = host
        self._command = command
        session, params, robot = host.session, host.config.kernel, host.options.robot
        latch = Latch(latch_path(robot))
        session.last.push_async_callback(latch.close)
        host.warnings.append(latch.warning)
        stop = latch.read()
        first = State() if stop is None else latched(*stop)
        kernel = Kernel(params, with_lifecycle(first, autostart=host.config.autostart))
        self.recorder = FlightRecorder(
            host.options,
            host.config,
            session,
            lambda: kernel.state.mode.name,
            on_failure=lambda detail: self._inputs.recorder_failed(detail),
            on_file=lambda: self._control.journal_snapshot(time.monotonic_ns()),
        )
        tap = self.recorder.tap
        for topic in (command_topic(params.command.topic, command), STATUS, *CALLS):
            tap.subscribe_own(topic)
        self._velocity = VelocityPublisher(
            session, params.command.topic, command, lambda: self._control.state.silent
        )
        self._watchdog = Watchdog(params.rate_hz, self._velocity)
        requests = PendingRequests()
        truth = GroundTruth()
        decisions = Decisions(host.decisions, self.recorder.show_event)
        self._control = Control(
            kernel,
            Journal(
                self.recorder.open_journal(JournalPublisher(session)),
                lambda: self._velocity.accounted,
            ),
            Effects(
                self._velocity.publish,
                lambda mode: self._shown.show(mode),
                self.recorder.note,
                latch,
                requests,
                robot,
                lambda change: self._parameters.changed(change),
                decisions.decided,
                truth.errors,
                lambda ended: self._robot_report.drive_ended(ended),
            ).carry_out,
            requests,
            host.supervisor.callback_failed,
            partial(urgent_event, self._watchdog),
            decisions.asked,
        )
        self._parameters = Parameters(host.config, self._control, self.recorder.reconfigure)
        self._loop = ControlLoop(params.rate_hz, self._control, self._watchdog, self._velocity)
        host.supervisor.report_to(self._control.dispatch)
        self._robot_report = RobotReport(self._control, truth)
        self._status = StatusSource(
            host.options,
            self.recorder.report,
            self._robot_report,
            session.scheduling,
            host.warnings,
        )
        self._diagnostics = Diagnostics(session, robot, self.recorder.report, self._status)
        self.recorder.health.on_news = self._diagnostics.publish
        if host.config.on_topic_trouble == "refuse":
            self.recorder.health.on_troubles = host.supervisor.topics_in_trouble
        remote = RemoteRequests(self._velocity.gid)
        self._inputs = Inputs(self._control, self._robot_report, remote.is_remote)
        self._odometry = OdomSubscriber(
            session,
            params.odometry.topic,
            self._take_odometry,
            self._inputs.odometry_source,
            ODOMETRY[params.odometry.qos],
        )
        create_input_roles(session, params, robot, self._inputs, command)
        self._modes = ModeService(session, robot, self._inputs.service_call, self._say)
        lock = CommandLock(self._modes.node, params.command.lock_topic)
        self._shown = ShownStatus(self._modes, self._control, self._robot_report, lock)
        self._last_zero = LastZero(self._velocity, self._modes, self.recorder.received)
        follow_lifecycle(self._modes.node, self._inputs, autostart=host.config.autostart)
        self._simulated: SimulatedRobot | None = None
        self._leases = LeaseMethods(self._control, robot)
        self._driving = DrivingMethods(
            self._control, self._robot_report, robot, self._leases.client_of
        )
        goals = DriveGoals(self._control, self._driving, remote.is_remote)
        session.last.callback(DriveAction(self._modes.node, goals.begin, self._say).close)

    def methods(self) -> Mapping[str, Method[Any]]:
        """Return the methods of the control socket."""
        return {
            **common_methods(self._status, self._host.stop),
            **recording_methods(self.recorder, self._host.options.robot),
            **graph_methods(self.recorder.tap),
            **self._driving.table(),
            **self._leases.table(),
            **simulation_methods(lambda: self._simulated, self._control, self.recorder.mark),
            **parameter_methods(self._parameters, self._host.options.robot),
        }

    async def run(self, server: ControlServer, notes: list[str], on_ready: Ready) -> None:
        """Run every task until the daemon is stopped."""
        self._control.journal_snapshot(time.monotonic_ns())
        # Without a last snapshot, a check could not tell whether the last entries are there.
        self._host.session.last.callback(
            lambda: self._control.journal_snapshot(time.monotonic_ns())
        )
        sim = self._host.options.sim
        if sim is None:
            sim = self._host.alone or not await has_odometry_publisher(
                self._odometry, self._host.stop, self._host.discovered_by_s
            )
            if not sim:
                notes = [*notes, f"no simulator: {self._odometry.topic} has a publisher already"]
        self._robot_report.sim = sim
        work = {**self._work(sim), "socket": server.serve}
        serve_parameters(self._host.session, self._parameters, self._host.options.robot)
        async with running(self._host.supervisor, work):
            with self._watchdog:
                ready = await self._become_ready(notes, on_ready)
                await self._host.stop.wait()
                _log.info("stopping")
                await stand_still(self._control, lambda: self._velocity.published)
        await self._last_zero.arrived()
        if not ready:
            raise RobotctlError("the daemon was stopped before it was ready")

    def mode(self) -> str:
        """Return the name of the mode."""
        return self._control.state.mode.name

    async def stop_robot(self) -> None:
        """Send a last zero, and record it."""
        try:
            send_zero(self._control, self._velocity)
            await self._last_zero.arrived()
        except Exception:  # noqa: BLE001 - the first failure is the one to report
            _log.exception("no last zero could be sent")

    # Tasks

    def _work(self, sim: bool) -> dict[str, Work]:
        work: dict[str, Work] = {
            "control": lambda: self._loop.run(self._odometry.look),
            **self.recorder.work(),
            "diagnostics": self._diagnostics.run,
            "graph watch": partial(
                watch_graph, self._velocity, self._odometry, self._control.dispatch
            ),
            "status": self._shown.run,
        }
        if sim:
            self._simulated = recorded_robot(
                self._host.session, self._host.config, self._command, self.recorder.tap
            )
            self._robot_report.ground_truth.truth = self._simulated.truth
            work["simulated robot"] = self._simulated.run
        return work

    def _take_odometry(self, odometry: Odometry, source: int, sequence: int) -> None:
        self._loop.look_at_commands()  # twice as often as the ticks alone
        self._inputs.odometry(odometry, source, sequence)

    # Start

    async def _become_ready(self, notes: list[str], on_ready: Ready) -> bool:
        stop = self._host.stop
        await until(lambda: not self._robot_report.missing() or stop.is_set(), READY_S)
        if stop.is_set():
            return False
        notes = [
            *notes,
            *(f"no robot to drive yet: {text}" for text in self._robot_report.missing()),
        ]
        if self._host.options.drive is not None:
            reply = await self._driving.begin(self._host.options.drive, "robotctl start --drive")
            notes = [*notes, self._say(reply)]
        on_ready(self._status.summary(notes))
        _log.info("ready")
        return True

    def _say(self, reply: Reply) -> str:
        return advice(reply.message, reply.remedies, self._host.options.robot).sentence
