"""The daemon that drives a robot, and records the whole ROS graph."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from robotctl.base.errors import RobotctlError
from robotctl.base.paths import latch_path
from robotctl.daemon.api.driving import DrivingMethods
from robotctl.daemon.api.lease import LeaseMethods
from robotctl.daemon.api.simulation import simulation_methods
from robotctl.daemon.api.status import (
    StatusSource,
    common_methods,
    graph_methods,
    recording_methods,
)
from robotctl.daemon.api.warnings import Warnings
from robotctl.daemon.control.control_loop import ControlLoop, Watchdog
from robotctl.daemon.control.decisions import Decisions
from robotctl.daemon.control.dispatcher import Control, Journal, PendingRequests
from robotctl.daemon.control.effects import Effects
from robotctl.daemon.control.inputs import (
    Inputs,
    has_odometry_publisher,
    is_remote,
    watch_graph,
)
from robotctl.daemon.control.latch import Latch, LatchedStop
from robotctl.daemon.control.robot_report import GroundTruth, RobotReport, ShownStatus
from robotctl.daemon.host import Diagnostics, Host, Ready, running
from robotctl.daemon.parameters import Parameters, parameter_methods, serve_parameters
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.shutdown import last_zero_arrived, send_zero, stand_still
from robotctl.daemon.simulator import recorded_robot
from robotctl.daemon.supervisor import Work, until
from robotctl.ipc.advice import advice
from robotctl.ipc.server import ControlServer, Method
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.safety_inputs import Use
from robotctl.kernel.state import Health, State, latched
from robotctl.kernel.types import (
    BatteryReceived,
    Cause,
    LifecycleState,
    Odometry,
    OdometrySourceFound,
    Reply,
    SafetyInputReceived,
    ScanReceived,
)
from robotctl.ros.message_types import CommandType
from robotctl.ros.nodes.drive_action import DriveAction
from robotctl.ros.nodes.input_subscribers import (
    report_battery,
    report_safety_inputs,
    report_scans,
    report_wanted_commands,
)
from robotctl.ros.nodes.mode_service import CALLS, STATUS, ModeService
from robotctl.ros.nodes.odom_subscriber import WANTED, OdomSubscriber
from robotctl.ros.nodes.publishers import CommandLock, JournalPublisher
from robotctl.ros.nodes.simulated_robot import SimulatedRobot
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher, command_topic

_log = logging.getLogger(__name__)

READY_S = 10.0
"""Limit on a start's wait for its inputs and for a subscriber of the command."""


class Driver:
    """Drives a robot and records its topics."""

    def __init__(self, host: Host, command: CommandType) -> None:
        """Create the kernel, the ROS nodes and the recorder, and connect them."""
        self._host, self._command = host, command
        # Only control and recorder use parts that are created later: they get these as attributes.
        session, params, robot = host.session, host.config.kernel, host.options.robot
        say = partial(_sentence, robot=robot)
        self._simulated: SimulatedRobot | None = None
        latch = Latch(latch_path(robot))
        session.last.push_async_callback(latch.close)
        host.warnings.append(latch.warning)
        kernel = Kernel(params, _first_state(latch.read(), autostart=host.config.autostart))
        self.recorder = recorder = FlightRecorder(
            host.options, host.config, session, lambda: kernel.state.mode.name
        )
        for topic in (command_topic(params.command.topic, command), STATUS, *CALLS):
            recorder.tap.subscribe_own(topic)
        self._velocity = velocity = VelocityPublisher(
            session, params.command.topic, command, lambda: kernel.state.silent
        )
        self._watchdog = Watchdog(params.rate_hz, velocity)
        requests, truth = PendingRequests(), GroundTruth()
        decisions = Decisions(host.decisions, recorder.show_event)
        self._control = control = Control(
            kernel,
            Journal(recorder.open_journal(JournalPublisher(session)), lambda: velocity.accounted),
            requests,
            host.supervisor.callback_failed,
            self._watchdog.take,
            decisions.asked,
        )
        self._parameters = Parameters(host.config, control, recorder.reconfigure)
        self._loop = loop = ControlLoop(params.rate_hz, control, self._watchdog, velocity)
        host.supervisor.report_to(control.dispatch)
        self._report = RobotReport(control, truth)
        warnings = Warnings(robot, recorder, control, host.warnings)
        self._status = StatusSource(
            host.options, recorder.report, self._report, session.executor.scheduling, warnings
        )
        self._diagnostics = Diagnostics(session, robot, recorder.report, warnings)
        remote = partial(is_remote, velocity.gid)
        inputs = Inputs(control, self._report, remote)

        def hear_odometry(odometry: Odometry, source: int, sequence: int) -> None:
            loop.look_at_commands()  # in addition to the ticks, so twice as often
            inputs.odometry(odometry, source, sequence)

        self._odometry = OdomSubscriber(
            session,
            params.odometry.topic,
            hear_odometry,
            inputs.hears(OdometrySourceFound),
            WANTED[params.odometry.qos],
        )
        if params.battery.topic:
            report_battery(session, params.battery.topic, inputs.hears(BatteryReceived))
        if params.scan.use is not Use.OFF:
            report_scans(session, params.scan.topic, inputs.hears(ScanReceived))
        if params.guard:
            report_wanted_commands(session, params.guard_topic, command, inputs.guarded_command)
        report_safety_inputs(session, params.inputs, robot, inputs.hears(SafetyInputReceived))
        self._modes = modes = ModeService(session, robot, inputs.service_call, say)
        self._shown = ShownStatus(
            modes, control, CommandLock(modes.node, params.command.lock_topic)
        )
        if host.config.autostart:
            modes.node.start()
        source = f"the lifecycle of {modes.node.get_fully_qualified_name()}"
        modes.node.changed = lambda state: inputs.lifecycle(state, source)
        self._leases = LeaseMethods(control, robot)
        self._driving = driving = DrivingMethods(
            control, self._report, robot, self._leases.client_of
        )
        action = DriveAction(
            modes.node, lambda goal, by: driving.begin_goal(goal, by, remote=remote()), say
        )
        session.last.callback(action.close)
        control.carry_out = Effects(
            velocity.publish,
            self._shown.show,
            recorder.note,
            latch,
            requests,
            robot,
            self._parameters.changed,
            decisions.decided,
            truth.errors,
            self._report.drive_ended,
        ).carry_out
        recorder.on_failure = partial(host.supervisor.report_state, Cause.RECORDER_FAILED)
        recorder.on_file = self._journal_snapshot  # a check needs one at the file's beginning
        recorder.sinks.on_news = self._diagnostics.publish
        if host.config.on_topic_trouble == "refuse":
            recorder.sinks.on_troubles = partial(host.supervisor.report_state, Cause.TOPIC_TROUBLE)

    def methods(self) -> Mapping[str, Method[Any]]:
        """Return the methods of the control socket."""
        robot = self._host.options.robot
        return {
            **common_methods(self._status, self._host.stop),
            **recording_methods(self.recorder, robot),
            **graph_methods(self.recorder.tap),
            **self._driving.table(),
            **self._leases.table(),
            **simulation_methods(lambda: self._simulated, self._control, self.recorder.mark),
            **parameter_methods(self._parameters, robot),
        }

    async def run(self, server: ControlServer, notes: list[str], on_ready: Ready) -> None:
        """Run every task until the daemon is stopped.

        Raises:
            RobotctlError: The daemon was stopped before it was ready.
        """
        self._journal_snapshot()
        # Without a last snapshot, a check could not detect that the last entries are missing.
        self._host.session.last.callback(self._journal_snapshot)
        sim = self._host.options.sim
        if sim is None:
            sim = self._host.alone or not await has_odometry_publisher(
                self._odometry, self._host.stop, self._host.discovered_by_s
            )
            if not sim:
                notes = [*notes, f"no simulator: {self._odometry.topic} has a publisher already"]
        self._report.sim = sim
        work = {**self._work(sim), "socket": server.serve}
        serve_parameters(self._host.session, self._parameters, self._host.options.robot)
        async with running(self._host.supervisor, work):
            with self._watchdog:
                ready = await self._become_ready(notes, on_ready)
                await self._host.stop.wait()
                _log.info("stopping")
                await stand_still(self._control, lambda: self._velocity.published)
        await last_zero_arrived(self._velocity, self._modes, self.recorder.received)
        if not ready:
            raise RobotctlError("the daemon was stopped before it was ready")

    def mode(self) -> str:
        """Return the name of the robot's mode."""
        return self._control.state.mode.name

    async def stop_robot(self) -> None:
        """Command zero velocity and wait for its recording; log any exception."""
        try:
            send_zero(self._control, self._velocity)
            await last_zero_arrived(self._velocity, self._modes, self.recorder.received)
        except Exception:  # noqa: BLE001 - the first failure is the one to report
            _log.exception("no last zero could be sent")

    def _journal_snapshot(self) -> None:
        self._control.journal_snapshot(time.monotonic_ns())

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
            self._report.ground_truth.truth = self._simulated.truth
            work["simulated robot"] = self._simulated.run
        return work

    async def _become_ready(self, notes: list[str], on_ready: Ready) -> bool:
        stop, drive = self._host.stop, self._host.options.drive
        await until(lambda: not self._report.missing() or stop.is_set(), READY_S)
        if stop.is_set():
            return False
        notes = [*notes, *(f"no robot to drive yet: {text}" for text in self._report.missing())]
        if drive is not None:
            reply = await self._driving.begin(drive, "robotctl start --drive")
            notes = [*notes, _sentence(reply, self._host.options.robot)]
        on_ready(self._status.summary(notes))
        _log.info("ready")
        return True


def _first_state(stop: LatchedStop | None, *, autostart: bool) -> State:
    """Return the kernel's first state, with the latched `stop` if any."""
    lifecycle = LifecycleState.ACTIVE if autostart else LifecycleState.UNCONFIGURED
    state = State() if stop is None else latched(*stop)
    return replace(state, health=Health(lifecycle=lifecycle))


def _sentence(reply: Reply, robot: str) -> str:
    """Return a reply's message with its advice to the operator, if any."""
    return advice(reply.message, reply.remedies, robot).sentence
