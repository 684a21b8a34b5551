"""The executable `mode_service`: the owner of the mode, for `ros2 run`, launch files and shells.

Parameters: `robot_name` (default: the last part of the namespace), `recordings` (default:
./recordings), `config` (a file as for `robotctl start`), `standalone` (default true) and every key
of the configuration.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from robotctl import environment, ros_arguments
from robotctl.config.ros_settings import USE_SIM_TIME, given_values
from robotctl.daemon.command_line import DaemonOptions, absolute
from robotctl.daemon.control.robot_report import ALONE
from robotctl.daemon.lock import owned
from robotctl.daemon.log.lines import log_to_stderr
from robotctl.daemon.startup import allow_many_files
from robotctl.domains import requested_domain
from robotctl.errors import RobotctlError
from robotctl.paths import DEFAULT_ROBOT, check_robot_name, lock_path
from robotctl.ros_arguments import Assignment
from robotctl.streams import open_standard_streams

NODE_NAME = "mode_service"

LINE = f"[%(levelname)s] [%(created).9f] [{NODE_NAME}]: %(message)s"
"""The log line of a ROS node."""

_log = logging.getLogger(__name__)


def main() -> int:
    """Run the owner until SIGINT, SIGTERM or SIGHUP; return the exit code."""
    open_standard_streams()
    note = environment.prepare()
    logging.addLevelName(logging.WARNING, "WARN")
    with ExitStack() as at_end, log_to_stderr(LINE):
        try:
            options = options_of(sys.argv)
            at_end.enter_context(owned(lock_path(options.robot), options.robot))
            allow_many_files()
            _run(options, [note] if note else [], at_end)
        except KeyboardInterrupt:  # before the loop handles signals
            _log.info("Shutting down ...")
        except RobotctlError as error:
            _log.error("%s", error)
            return error.exit_code
    return 0


def options_of(words: list[str]) -> DaemonOptions:
    """Return the options of a command line with `--ros-args`.

    Raises:
        UsageError: A name or an argument is wrong.
    """
    _, ros_words = ros_arguments.split(ros_arguments.with_log_levels(words))
    given = ros_arguments.parse(ros_words)
    names = {node or NODE_NAME: name for node, name in given.node_names.items()}
    given = replace(given, node_names=names)
    namespace = given.namespace or ""
    settings = {"standalone": True, **given_values(given, namespace, (NODE_NAME,))}
    name = settings.pop("robot_name", None) or namespace.rpartition("/")[2]
    recordings = settings.pop("recordings", "recordings")
    config = settings.pop("config", None)
    return DaemonOptions(
        robot=check_robot_name(str(name or DEFAULT_ROBOT)),
        config=None if config is None else Path(str(config)),
        recordings=absolute(Path(str(recordings))),
        drive=None,
        sim=False,
        domain_id=requested_domain(None) or 0,
        owner=True,
        settings=tuple((key, value) for key, value in settings.items() if key != USE_SIM_TIME),
        ros_namespace=namespace,
        ros=replace(given, settings=_time(settings)),
    )


def _time(settings: Mapping[str, object]) -> tuple[Assignment, ...]:
    """Return the setting of `use_sim_time`, which is no key of the configuration."""
    if USE_SIM_TIME not in settings:
        return ()
    return (Assignment("", USE_SIM_TIME, str(settings[USE_SIM_TIME]).lower()),)


def _run(options: DaemonOptions, notes: list[str], at_end: ExitStack) -> None:
    from robotctl.daemon.app import serve  # after environment.prepare(): it imports rclpy
    from robotctl.ros.executor import run

    def on_ready(summary: Mapping[str, Any]) -> None:
        for each in summary["notes"]:
            _log.warning("%s", each)

    _log.info("Mode Service Node started")
    if dict(options.settings)["standalone"] is True:
        _log.warning("while there is %s", ALONE)
    run(serve(options, notes, on_ready, at_end))
