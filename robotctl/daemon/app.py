"""The composition root: what every daemon does from start to end, driving or only recording."""

from __future__ import annotations

import asyncio
import gc
import os
import time
from contextlib import AsyncExitStack, ExitStack

from robotctl import __version__
from robotctl.base.domains import is_certainly_empty
from robotctl.base.own_process import end_signals
from robotctl.base.paths import chain_to, robot_state_folder, socket_path
from robotctl.config import Config, load
from robotctl.config.ros_settings import MODE_SERVICE
from robotctl.daemon.command_choice import choose_command_type
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.decision_notes import noted, open_decision_log
from robotctl.daemon.driver import build
from robotctl.daemon.host import DaemonKind, Host, Ready
from robotctl.daemon.log.levels import LoggerLevels
from robotctl.daemon.observer import Observer
from robotctl.daemon.recording.recordings_folder import save_recordings_path
from robotctl.daemon.ros_logs import apply_levels, published_log, serve_logger_levels
from robotctl.daemon.same_names import refuse_same_names
from robotctl.daemon.service_manager import ServiceManager, reporting
from robotctl.daemon.supervisor import Supervisor
from robotctl.daemon.waiting import DISCOVERY_S
from robotctl.ipc.answers import StartSummary
from robotctl.ipc.listener import remove_stale, socket_group
from robotctl.ipc.request_handler import Identity
from robotctl.ipc.server import ControlServer
from robotctl.ros.session import RECORDER_NODE, Naming, ros_session


async def serve(
    options: DaemonOptions, notes: list[str], on_ready: Ready, at_end: ExitStack
) -> None:
    """Run the daemon until it is stopped; call `on_ready` once with the summary.

    The exit of `at_end` leaves the ROS domain. The caller owns the robot's lock.

    Raises:
        RobotctlError: The daemon cannot start, or ran out of memory.
    """
    stop = end_signals()
    manager = ServiceManager()
    settings = options.applied_to(load(options.config) if options.config else Config())
    config = settings.config
    group = socket_group(config.socket.group)
    address = socket_path(options.robot)
    # A daemon whose lock file was deleted may still own the robot: it answers at the socket.
    remove_stale(address)
    alone = is_certainly_empty(options.domain_id)
    supervisor = Supervisor(stop.set)
    asyncio.get_running_loop().set_exception_handler(supervisor.loop_failed)
    async with (
        ros_session(
            domain_id=options.domain_id,
            namespace=options.namespace,
            at_end=at_end,
            on_exception=supervisor.callback_failed,
            fifo_priority=config.fifo_priority or None,
            naming=Naming(
                tuple(rule.argument() for rule in settings.remaps), options.ros.node_names
            ),
            use_sim_time=settings.use_sim_time,
        ) as session,
        AsyncExitStack() as stack,
    ):
        own_logger = session.logger_name(RECORDER_NODE if options.observe else MODE_SERVICE)
        levels = LoggerLevels(own_logger)
        apply_levels(levels, options.log_levels)
        notes = [
            *notes,
            *await asyncio.to_thread(save_recordings_path, options.recordings, options.robot),
        ]
        for folder in (address.parent, robot_state_folder(options.robot)):
            notes += chain_to(folder).group_writable()
        if group is not None:
            notes.append(f"each member of group {group.name} may give commands (socket.group)")
        host = Host(
            options,
            config,
            alone,
            supervisor,
            time.monotonic() + DISCOVERY_S,
            stop,
            session,
            open_decision_log(options, config),
            warnings=[],
        )
        host.warnings.append(host.decisions.warning)
        if not options.observe:
            await refuse_same_names(host)
        daemon: DaemonKind = (
            Observer(host) if options.observe else build(host, await choose_command_type(host))
        )
        session.last.enter_context(published_log(session, levels))
        session.last.push_async_callback(daemon.recorder.close)  # when no message comes any more
        identity = Identity(options.robot, __version__, os.getpid())
        server = ControlServer(
            address,
            daemon.methods(),
            identity,
            group=group,
            on_unreachable=supervisor.unreachable,
        )
        host.warnings.append(server.warning)
        try:
            stack.enter_context(server)
        except BaseException:
            await daemon.recorder.discard()
            raise
        gc.collect()
        gc.freeze()  # a full collection over all imported objects would block the loop for 70 ms
        gc.enable()  # in a process of its own it is off until here

        def ready(summary: StartSummary) -> None:
            serve_logger_levels(session, levels)
            on_ready(summary)
            manager.ready()
            daemon.recorder.tidier.begin()  # not earlier: it may take long

        async with noted(host.decisions, options, config, daemon.recorder):
            try:
                async with reporting(manager, daemon.mode):
                    await daemon.run(server, notes, ready)
            except BaseException:
                await daemon.stop_robot()
                raise
    supervisor.check()
