"""The daemon that drives a robot, and records the whole ROS graph."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from robotctl.base.errors import RobotctlError
from robotctl.base.paths import latch_path
from robotctl.daemon.api.driving import DriveGoals, DrivingMethods
from robotctl.daemon.api.lease import LeaseMethods
from robotctl.daemon.api.simulation import simulation_methods
from robotctl.daemon.api.status import (
    StatusSource,
    common_methods,
    graph_methods,
    recording_methods,
)
from robotctl.daemon.api.warnings import Warnings
from robotctl.daemon.control.control_loop import ControlLoop, Watchdog, urgent_event
from robotctl.daemon.control.decisions import Decisions
from robotctl.daemon.control.dispatcher import Control, Journal, PendingRequests
from robotctl.daemon.control.effects import Effects
from robotctl.daemon.control.inputs import (
    Inputs,
    RemoteRequests,
    has_odometry_publisher,
    watch_graph,
)
from robotctl.daemon.control.latch import Latch
from robotctl.daemon.control.robot_report import GroundTruth, RobotReport, ShownStatus
from robotctl.daemon.host import Diagnostics, Host, Ready, running
from robotctl.daemon.parameters import Parameters, parameter_methods, serve_parameters
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.shutdown import LastZero, send_zero, stand_still
from robotctl.daemon.simulator import recorded_robot
from robotctl.daemon.supervisor import Work, until
from robotctl.ipc.advice import advice
from robotctl.ipc.request_handler import Method
from robotctl.ipc.server import ControlServer
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.safety_inputs import Use
from robotctl.kernel.state import Health, State, latched
from robotctl.kernel.types import LifecycleState, Odometry, Reply
from robotctl.ros.message_types import CommandType
from robotctl.ros.nodes.drive_action import DriveAction
from robotctl.ros.nodes.input_subscribers import (
    BatterySubscriber,
    GuardSubscriber,
    SafetyInputs,
    ScanSubscriber,
)
from robotctl.ros.nodes.mode_service import CALLS, STATUS, ModeService
from robotctl.ros.nodes.node_services import ManagedNode
from robotctl.ros.nodes.odom_subscriber import WANTED, OdomSubscriber
from robotctl.ros.nodes.publishers import CommandLock, JournalPublisher
from robotctl.ros.nodes.simulated_robot import SimulatedRobot
from robotctl.ros.nodes.velocity_publisher import VelocityPublisher, command_topic
from robotctl.ros.session import Session


def create_input_roles(
    session: Session, params: KernelParams, robot: str, inputs: Inputs, command: CommandType
) -> None:
    """Subscribe to each configured input topic, and pass its messages to `inputs`."""
    if params.battery.topic:
        BatterySubscriber(session, params.battery.topic, inputs.battery)
    if params.scan.use is not Use.OFF:
        ScanSubscriber(session, params.scan.topic, inputs.scan)
    if params.guard:
        GuardSubscriber(session, params.guard_topic, command, inputs.guarded_command)
    SafetyInputs(session, params.inputs, robot, inputs.safety_input)


def with_lifecycle(state: State, *, autostart: bool) -> State:
    """Return `state` with the lifecycle ACTIVE if `autostart`, otherwise UNCONFIGURED."""
    first = LifecycleState.ACTIVE if autostart else LifecycleState.UNCONFIGURED
    return replace(state, health=Health(lifecycle=first))


def follow_lifecycle(node: ManagedNode, inputs: Inputs, *, autostart: bool) -> None:
    """Activate the node if `autostart`; pass its later transitions to `inputs`."""
    if autostart:
        node.start()
    source = f"the lifecycle of {node.get_fully_qualified_name()}"
    node.changed = lambda state: inputs.lifecycle(state, source)


_log = logging.getLogger(__name__)

READY_S = 10.0
"""How long a start waits for what the configuration expects: odometry, battery level, and a
subscriber of the command. Discovery by Fast DDS takes up to 2.6 s; a robot may still boot."""


@dataclass(slots=True)
class Driver:
    """Drives a robot and records, with the parts that `build` creates and connects."""

    host: Host
    command: CommandType
    recorder: FlightRecorder
    velocity: VelocityPublisher
    watchdog: Watchdog
    control: Control
    loop: ControlLoop
    parameters: Parameters
    report: RobotReport
    status: StatusSource
    diagnostics: Diagnostics
    odometry: OdomSubscriber
    shown: ShownStatus
    last_zero: LastZero
    leases: LeaseMethods
    driving: DrivingMethods
    simulated: SimulatedRobot | None = None
    """Set by `run` if the daemon simulates the robot."""

    def methods(self) -> Mapping[str, Method[Any]]:
        """Return the methods of the control socket."""
        robot = self.host.options.robot
        return {
            **common_methods(self.status, self.host.stop),
            **recording_methods(self.recorder, robot),
            **graph_methods(self.recorder.tap),
            **self.driving.table(),
            **self.leases.table(),
            **simulation_methods(lambda: self.simulated, self.control, self.recorder.mark),
            **parameter_methods(self.parameters, robot),
        }

    async def run(self, server: ControlServer, notes: list[str], on_ready: Ready) -> None:
        """Run every task until the daemon is stopped.

        Raises:
            RobotctlError: The daemon was stopped before it was ready.
        """
        self._journal_snapshot()
        # Without a last snapshot, a check could not detect that the last entries are missing.
        self.host.session.last.callback(self._journal_snapshot)
        sim = self.host.options.sim
        if sim is None:
            sim = self.host.alone or not await has_odometry_publisher(
                self.odometry, self.host.stop, self.host.discovered_by_s
            )
            if not sim:
                notes = [*notes, f"no simulator: {self.odometry.topic} has a publisher already"]
        self.report.sim = sim
        work = {**self._work(sim), "socket": server.serve}
        serve_parameters(self.host.session, self.parameters, self.host.options.robot)
        async with running(self.host.supervisor, work):
            with self.watchdog:
                ready = await self._become_ready(notes, on_ready)
                await self.host.stop.wait()
                _log.info("stopping")
                await stand_still(self.control, lambda: self.velocity.published)
        await self.last_zero.arrived()
        if not ready:
            raise RobotctlError("the daemon was stopped before it was ready")

    def mode(self) -> str:
        """Return the name of the mode."""
        return self.control.state.mode.name

    async def stop_robot(self) -> None:
        """Send a last zero, and record it."""
        try:
            send_zero(self.control, self.velocity)
            await self.last_zero.arrived()
        except Exception:  # noqa: BLE001 - the first failure is the one to report
            _log.exception("no last zero could be sent")

    def _journal_snapshot(self) -> None:
        self.control.journal_snapshot(time.monotonic_ns())

    def _work(self, sim: bool) -> dict[str, Work]:
        work: dict[str, Work] = {
            "control": lambda: self.loop.run(self.odometry.look),
            **self.recorder.work(),
            "diagnostics": self.diagnostics.run,
            "graph watch": partial(
                watch_graph, self.velocity, self.odometry, self.control.dispatch
            ),
            "status": self.shown.run,
        }
        if sim:
            self.simulated = recorded_robot(
                self.host.session, self.host.config, self.command, self.recorder.tap
            )
            self.report.ground_truth.truth = self.simulated.truth
            work["simulated robot"] = self.simulated.run
        return work

    async def _become_ready(self, notes: list[str], on_ready: Ready) -> bool:
        stop, drive = self.host.stop, self.host.options.drive
        await until(lambda: not self.report.missing() or stop.is_set(), READY_S)
        if stop.is_set():
            return False
        notes = [*notes, *(f"no robot to drive yet: {text}" for text in self.report.missing())]
        if drive is not None:
            reply = await self.driving.begin(drive, "robotctl start --drive")
            notes = [*notes, _sentence(reply, self.host.options.robot)]
        on_ready(self.status.summary(notes))
        _log.info("ready")
        return True


def build(host: Host, command: CommandType) -> Driver:
    """Create the kernel, the ROS nodes and the recorder, and connect them.

    A part that uses another part is created after it. Only control and recorder also use parts that
    are created later: they get these as attributes, before the first event arrives.
    """
    session, params, robot = host.session, host.config.kernel, host.options.robot
    say = partial(_sentence, robot=robot)
    latch = Latch(latch_path(robot))
    session.last.push_async_callback(latch.close)
    host.warnings.append(latch.warning)
    stop = latch.read()
    first = State() if stop is None else latched(*stop)
    kernel = Kernel(params, with_lifecycle(first, autostart=host.config.autostart))
    recorder = FlightRecorder(host.options, host.config, session, lambda: kernel.state.mode.name)
    for topic in (command_topic(params.command.topic, command), STATUS, *CALLS):
        recorder.tap.subscribe_own(topic)
    velocity = VelocityPublisher(
        session, params.command.topic, command, lambda: kernel.state.silent
    )
    watchdog = Watchdog(params.rate_hz, velocity)
    requests, truth = PendingRequests(), GroundTruth()
    decisions = Decisions(host.decisions, recorder.show_event)
    control = Control(
        kernel,
        Journal(recorder.open_journal(JournalPublisher(session)), lambda: velocity.accounted),
        requests,
        host.supervisor.callback_failed,
        partial(urgent_event, watchdog),
        decisions.asked,
    )
    parameters = Parameters(host.config, control, recorder.reconfigure)
    loop = ControlLoop(params.rate_hz, control, watchdog, velocity)
    host.supervisor.report_to(control.dispatch)
    report = RobotReport(control, truth)
    warnings = Warnings(robot, recorder, control, host.warnings)
    status = StatusSource(host.options, recorder.report, report, session.scheduling, warnings)
    diagnostics = Diagnostics(session, robot, recorder.report, warnings)
    remote = RemoteRequests(velocity.gid)
    inputs = Inputs(control, report, remote.is_remote)

    def hear_odometry(odometry: Odometry, source: int, sequence: int) -> None:
        loop.look_at_commands()  # in addition to the ticks, so twice as often
        inputs.odometry(odometry, source, sequence)

    odometry = OdomSubscriber(
        session,
        params.odometry.topic,
        hear_odometry,
        inputs.odometry_source,
        WANTED[params.odometry.qos],
    )
    create_input_roles(session, params, robot, inputs, command)
    modes = ModeService(session, robot, inputs.service_call, say)
    shown = ShownStatus(modes, control, CommandLock(modes.node, params.command.lock_topic))
    follow_lifecycle(modes.node, inputs, autostart=host.config.autostart)
    leases = LeaseMethods(control, robot)
    driving = DrivingMethods(control, report, robot, leases.client_of)
    goals = DriveGoals(control, driving, remote.is_remote)
    session.last.callback(DriveAction(modes.node, goals.begin, say).close)
    control.carry_out = Effects(
        velocity.publish,
        shown.show,
        recorder.note,
        latch,
        requests,
        robot,
        parameters.changed,
        decisions.decided,
        truth.errors,
        report.drive_ended,
    ).carry_out
    recorder.on_failure = inputs.recorder_failed
    recorder.on_file = lambda: control.journal_snapshot(time.monotonic_ns())
    recorder.health.on_news = diagnostics.publish
    if host.config.on_topic_trouble == "refuse":
        recorder.health.on_troubles = host.supervisor.topics_in_trouble
    return Driver(
        host=host,
        command=command,
        recorder=recorder,
        velocity=velocity,
        watchdog=watchdog,
        control=control,
        loop=loop,
        parameters=parameters,
        report=report,
        status=status,
        diagnostics=diagnostics,
        odometry=odometry,
        shown=shown,
        last_zero=LastZero(velocity, modes, recorder.received),
        leases=leases,
        driving=driving,
    )


def _sentence(reply: Reply, robot: str) -> str:
    """Return the message of a reply with its cure, as one sentence."""
    return advice(reply.message, reply.remedies, robot).sentence
