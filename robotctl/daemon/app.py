"""The composition root: the steps of a daemon, driver or observer, from its start to its end."""

from __future__ import annotations

import asyncio
import gc
import os
import time
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager
from dataclasses import replace
from functools import partial
from typing import Final

from robotctl import __version__
from robotctl.base.domains import is_certainly_empty
from robotctl.base.errors import Refused
from robotctl.base.own_process import end_signals
from robotctl.base.paths import chain_to, robot_state_folder, socket_path
from robotctl.config import Config, flat, load
from robotctl.config.ros_settings import MODE_SERVICE, NODES
from robotctl.config.settings import log_warning
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.driver import Driver
from robotctl.daemon.host import Host, Ready
from robotctl.daemon.observer import Observer
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.recording.provenance import DIGEST, provenance, software
from robotctl.daemon.recording.recordings_folder import save_recordings_path
from robotctl.daemon.ros_logs import LoggerLevels, published_log, serve_logger_levels
from robotctl.daemon.service_manager import ServiceManager
from robotctl.daemon.supervisor import DISCOVERY_S, Supervisor, until
from robotctl.decisions.journal import YEAR_S, DecisionKind, log_folder
from robotctl.decisions.log import DecisionLog
from robotctl.ipc.answers import StartSummary
from robotctl.ipc.listener import remove_stale, socket_group
from robotctl.ipc.server import ControlServer, Identity
from robotctl.kernel.constants import COMMAND_TYPES, TWIST_STAMPED
from robotctl.kernel.params import CommandParams, Stamping
from robotctl.kernel.types import Cause
from robotctl.ros.graph import endpoints
from robotctl.ros.message_types import COMMANDS, PLAIN, CommandType, stamped
from robotctl.ros.nodes.velocity_publisher import is_monitor
from robotctl.ros.session import RECORDER_NODE, ros_session

PROBE_NODE = "_command_probe"
"""Name of the hidden node that reads the robot's command type from the graph."""


async def choose_command_type(host: Host) -> CommandType:
    """Return Twist or TwistStamped, as configured or, for `auto`, as the robot subscribes."""
    command = host.config.kernel.command
    if command.stamped is Stamping.AUTO and not (host.alone or host.options.sim):
        chosen = await _taken_type(host, command)
    else:
        chosen = stamped(command.frame_id) if command.stamped is Stamping.TRUE else PLAIN
    return replace(chosen, qos=COMMANDS[command.qos])


async def _taken_type(host: Host, command: CommandParams) -> CommandType:
    node = host.session.node(PROBE_NODE)

    def taken() -> frozenset[str]:
        found = endpoints.subscriptions(node, host.session.resolve(command.topic))
        types = (each.topic_type for each in found if not is_monitor(each.node_name))
        return COMMAND_TYPES.intersection(types)

    try:
        remaining_s = host.discovered_by_s - time.monotonic()
        await until(lambda: bool(taken()) or host.stop.is_set(), remaining_s)
        return stamped(command.frame_id) if taken() == {TWIST_STAMPED} else PLAIN
    finally:
        host.session.remove(node)


STABLE_S: Final = 0.6
"""Time without a new node after which discovery is complete; daemons announce every 0.5 s."""

LOOK_S: Final = 0.05


async def refuse_same_names(host: Host) -> None:
    """Raise Refused if another daemon has a `mode_service` of the same full name in the domain.

    Call this before the daemon has a publisher. It waits for the discovery of the domain's nodes.
    With `--allow-same-names` it does nothing.
    """
    options = host.options
    if host.alone or options.allow_same_names:
        return
    names = options.ros.node_names
    own = {node: f"{options.namespace}/{names.get(node, node)}" for node in NODES}
    node = host.session.helper()
    before: Counter[str] = Counter()
    changed = time.monotonic()
    while not host.stop.is_set():
        found = Counter(
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in node.get_node_names_and_namespaces()
        )
        if own[MODE_SERVICE] in found:
            same = ", ".join(name for name in own.values() if name in found)
            raise Refused(
                f"another daemon in ROS domain {options.domain_id} has the same nodes: {same}",
                "give this one another name (--robot NAME) or domain (--domain-id N); "
                "--allow-same-names starts it all the same",
            )
        now = time.monotonic()
        if found != before:
            before, changed = found, now
        is_stable = found.total() > 1 and now - changed >= STABLE_S
        if is_stable or now >= host.discovered_by_s:
            return
        await asyncio.sleep(LOOK_S)


OF_ONE_START: Final = ("directory", "git.directory", "user")
"""Keys of `provenance` that describe one start of the daemon, not its software."""


def _note_start(
    log: DecisionLog, options: DaemonOptions, config: Config, recorder: FlightRecorder
) -> None:
    """Log who started the daemon, and changes of the software and the configuration."""
    known = provenance()
    log.add(
        DecisionKind.START,
        by=f"{known['user']}, pid {os.getpid()}",
        version=__version__,
        software=software().get(DIGEST, "")[:16],
        recording=str(recorder.folder),
        observe=options.observe,
        config=None if options.config is None else str(options.config),
    )
    identity = {key: value for key, value in known.items() if key not in OF_ONE_START}
    log.add_values(DecisionKind.SOFTWARE, {**identity, DIGEST: software().get(DIGEST, "")})
    log.add_values(DecisionKind.CONFIGURATION, flat(config))


@asynccontextmanager
async def noted(
    log: DecisionLog, options: DaemonOptions, config: Config, recorder: FlightRecorder
) -> AsyncIterator[None]:
    """Write the daemon's start and, after the block, its end to the journal `log`; close `log`."""
    _note_start(log, options, config, recorder)
    recorder.tidier.on_removed = lambda path: log.add(DecisionKind.REMOVED, file=path)
    failure: dict[str, str] = {}
    try:
        yield
    except BaseException as error:
        failure = {"failure": str(error) or type(error).__name__}
        raise
    finally:
        log.add(DecisionKind.END, **failure)
        await asyncio.to_thread(log.close)


async def serve(
    options: DaemonOptions, notes: list[str], on_ready: Ready, at_end: ExitStack
) -> None:
    """Run the daemon until it is stopped.

    `on_ready` is called with a summary that contains `notes`. The caller owns the robot's lock, and
    closes `at_end` afterwards to leave the ROS domain.

    Raises:
        RobotctlError: The daemon cannot start, or ran out of memory.
    """
    stop = end_signals()
    manager = ServiceManager()
    notes = list(notes)

    def warn(sentence: str) -> None:
        log_warning(sentence)
        notes.append(sentence)

    chosen = load(options.config, warn) if options.config else Config()
    settings = options.applied_to(chosen, warn)
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
            remaps=[rule.argument() for rule in settings.remaps],
            node_names=options.ros.node_names,
            use_sim_time=settings.use_sim_time,
        ) as session,
        AsyncExitStack() as stack,
    ):
        own_logger = session.logger_name(RECORDER_NODE if options.observe else MODE_SERVICE)
        levels = LoggerLevels(own_logger)
        levels.apply((*options.log_level, *options.ros.log_levels))
        notes += await asyncio.to_thread(save_recordings_path, options.recordings, options.robot)
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
            DecisionLog(log_folder(options.robot), config.decisions.keep_years * YEAR_S),
            warnings=[],
        )
        host.warnings.append(host.decisions.warning)
        if not options.observe:
            await refuse_same_names(host)
        daemon: Driver | Observer = (
            Observer(host) if options.observe else Driver(host, await choose_command_type(host))
        )
        session.last.enter_context(published_log(session, levels))
        session.last.push_async_callback(daemon.recorder.close)  # when no message comes any more
        identity = Identity(options.robot, __version__, os.getpid())
        server = ControlServer(
            address,
            daemon.methods(),
            identity,
            group=group,
            on_unreachable=partial(supervisor.report_state, Cause.UNREACHABLE),
        )
        host.warnings.append(server.warning)
        try:
            stack.enter_context(server)
        except BaseException:
            await daemon.recorder.discard()
            raise
        gc.freeze()  # a full collection over all imported objects would block the loop for 70 ms
        gc.enable()  # `__main__` has disabled it

        def ready(summary: StartSummary) -> None:
            serve_logger_levels(session, levels)
            on_ready(summary)
            manager.ready()
            daemon.recorder.tidier.begun.set()  # not earlier: it may take long

        async with noted(host.decisions, options, config, daemon.recorder):
            try:
                async with manager.reporting(daemon.mode):
                    await daemon.run(server, notes, ready)
            except BaseException:
                await daemon.stop_robot()
                raise
    supervisor.check()
