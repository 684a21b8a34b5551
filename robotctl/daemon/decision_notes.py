"""The start and the end of a daemon in the journal of decisions: who, with what software."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

from robotctl import __version__
from robotctl.config import Config, flat
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.recording.flight_recorder import FlightRecorder
from robotctl.daemon.recording.provenance import provenance
from robotctl.daemon.recording.software import DIGEST, software
from robotctl.decisions.journal import YEAR_S, DecisionKind, log_folder
from robotctl.decisions.log import DecisionLog

OF_ONE_START: Final = ("directory", "git.directory", "user")
"""What the start itself tells; it is no part of the software's identity."""


def open_decision_log(options: DaemonOptions, config: Config) -> DecisionLog:
    """Return the robot's journal of decisions; nothing is written yet."""
    return DecisionLog(log_folder(options.robot), config.decisions.keep_years * YEAR_S)


def _note_start(
    log: DecisionLog, options: DaemonOptions, config: Config, recorder: FlightRecorder
) -> None:
    """Note who started the daemon, and software and configuration where they have changed."""
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
    """Note start and end around a block; the end waits for the disk, for a moment."""
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
