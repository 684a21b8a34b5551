"""Runs the jobs of `robotctl gate` on a Dask cluster."""

from __future__ import annotations

import logging
import platform
import re
import socket
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from queue import Empty, Queue
from typing import TYPE_CHECKING, Final, NamedTuple

from robotctl.base.errors import IN_PARENTHESES, Refused, RobotctlError, UsageError
from robotctl.base.pool import Done
from robotctl.collection.judgement import software_hash, software_name
from robotctl.collection.judging import Answers, Judged, Judging, ResultStore

if TYPE_CHECKING:
    from distributed import Client


CONNECT_S: Final = 10.0
"""How long the gate waits for its first connection to the scheduler."""

PATIENCE_S: Final = 60.0
"""How long the gate waits for a lost scheduler or a first worker."""

_CHECK_S: Final = 5.0
"""Time without an answer after which the gate looks whether there are still workers."""

_ADDRESS = re.compile(r"(?:tcp|tls)://(?P<host>[^/\s]+|\[[^]\s]+\]):(?P<port>\d{1,5})")


class Cluster:
    """Runs a gate's jobs on Dask workers, which must all see the recordings' folder."""

    def __init__(
        self,
        address: str,
        place: Path,
        *,
        connect_s: float = CONNECT_S,
        patience_s: float = PATIENCE_S,
    ) -> None:
        """Check the scheduler's address without a connection; `place` is the recordings' folder.

        Raises:
            UsageError: The address is not tcp:// or tls://HOST:PORT, or Dask is not installed.
        """
        found = _ADDRESS.fullmatch(address)
        if found is None or int(found["port"]) > 65535:
            raise UsageError(f"{address} is no address of a cluster", "give tcp://HOST:PORT")
        try:
            import distributed  # noqa: F401
        except ImportError:
            raise UsageError(
                "a cluster needs Dask, which is not installed", "pip install 'robotctl[cluster]'"
            ) from None
        self._address = address
        self._endpoint = found["host"].strip("[]"), int(found["port"])
        self._place = place
        self._connect_s = connect_s
        self._patience_s = patience_s

    def judge(self, judging: Judging, recordings: Sequence[Path], on_progress: Done) -> Answers:
        """Judge recordings on the workers; yield each path with its result, in any order.

        Raises:
            Refused: No scheduler or no worker for too long, or a worker lacks files or software.
        """
        left = dict.fromkeys(recordings)
        connect_s = self._connect_s
        token = judging.store.put_token()
        judged = partial(_judged, token, judging)
        try:
            while left:
                with self._connected(connect_s) as client:
                    connect_s = self._patience_s
                    try:
                        self._check(client, judging, token)
                    except OSError:  # the scheduler is gone again
                        continue
                    for path, answer in _answers(client, judged, list(left)):
                        del left[path]
                        on_progress(len(recordings) - len(left), len(recordings))
                        yield path, answer
        finally:
            judging.store.remove_token(token)

    @contextmanager
    def _connected(self, connect_s: float) -> Iterator[Client]:
        from distributed import Client

        with _quiet():
            self._wait_for_port(connect_s)  # a Dask client that cannot connect logs a lot
            try:
                client = Client(self._address, timeout=connect_s, set_as_default=False)
            except (OSError, ValueError) as error:
                raise self._no_scheduler(error) from error
            with closing(client):
                try:
                    client.wait_for_workers(1, timeout=self._patience_s)
                except TimeoutError:
                    raise Refused(
                        f"the scheduler at {self._address} has no workers",
                        f"start some with `dask worker {self._address} --no-nanny --nthreads 1`",
                    ) from None
                yield client

    def _wait_for_port(self, seconds: float) -> None:
        """Wait until the scheduler's port answers."""
        until = time.monotonic() + seconds
        while True:
            try:
                with socket.create_connection(self._endpoint, timeout=seconds) as connection:
                    # A scheduler sends first; if the server does not, a Dask client waits forever.
                    if self._address.startswith("tcp:") and not connection.recv(1):
                        raise ConnectionError("it closes the connection")
            except OSError as error:
                if time.monotonic() > until:
                    raise self._no_scheduler(error) from error
                time.sleep(0.2)
            else:
                return

    def _check(self, client: Client, judging: Judging, token: str) -> None:
        """Raise Refused if a worker is unsuitable."""
        asked = str(self._place), str(judging.store), token
        found = client.run(_state, *asked, on_error="return")
        for worker, state in found.items():
            if isinstance(state, OSError):  # the worker has ended; others get its jobs
                continue
            if isinstance(state, RobotctlError):
                raise Refused(f"the worker {worker} does not see it: {state.cause}", state.cure)
            if isinstance(state, Exception):
                raise Refused(
                    f"the worker {worker} cannot run robotctl ({state})",
                    f"install {software_name()} there",
                )
            if state.software != judging.software:
                raise Refused(
                    f"the worker {worker} has another robotctl ({state.name}) than the gate",
                    f"install this one ({software_name()}) there, and start the worker again",
                )
            if not state.sees_place:
                raise Refused(
                    f"the worker {worker} does not see {self._place}",
                    "give --in a folder that all workers see under this name",
                )
            if not state.sees_results:
                raise _no_results(f"the worker {worker}", judging.store)

    def _no_scheduler(self, error: OSError | ValueError) -> Refused:
        said = (error.strerror if isinstance(error, OSError) else None) or error
        return Refused(
            f"no Dask scheduler answers at {self._address}: {said}",
            "start it with `dask scheduler`; the same command goes on from what is stored",
            sentence=IN_PARENTHESES,
        )


def _answers(
    client: Client, judged: Callable[[Path], Judged], recordings: Sequence[Path]
) -> Answers:
    """Yield answers until all are there, the scheduler has restarted or no worker is left."""
    if not (scheduler := _scheduler(client)):
        return
    executor = client.get_executor(pure=False)
    ready: Queue[Future[Judged]] = Queue()
    jobs: dict[Future[Judged], Path] = {}
    from distributed import KilledWorker

    for path in recordings:
        job = executor.submit(judged, path)
        jobs[job] = path
        job.add_done_callback(ready.put)
    patience_s = _CHECK_S
    try:
        while jobs:
            try:
                job = ready.get(timeout=patience_s)
            except Empty:
                if _scheduler(client) != scheduler:  # Dask reconnects, but its jobs are lost
                    return
                patience_s = _CHECK_S
                continue
            path = jobs.pop(job)
            try:
                yield path, job.result()
            except CancelledError:  # Dask has lost the connection
                patience_s = 0.0
            except KilledWorker:
                yield path, None
    finally:
        executor.shutdown(wait=False)


def _scheduler(client: Client) -> str:
    """Return the id of the connected scheduler, "" if there is none or it has no workers."""
    try:
        info = client.scheduler_info() if client.status == "running" else {}
    except OSError:
        return ""
    return str(info["id"]) if info.get("workers") else ""


class _State(NamedTuple):
    """The software of a worker, and its access to the recordings and the results."""

    software: str
    name: str
    sees_place: bool
    sees_results: bool


def _state(place: str, results: str, token: str) -> _State:
    """Return the state of this worker, in the worker."""
    return _State(software_hash(), software_name(), Path(place).exists(), _sees(token, results))


def _judged(token: str, judging: Judging, path: Path) -> Judged:
    if not _sees(token, str(judging.store)):  # a worker that came later
        raise _no_results(platform.node(), judging.store)
    return judging.judged(path)


def _sees(token: str, results: str) -> bool:
    """Return whether this worker sees the gate's results, in the worker."""
    return ResultStore(results).has_token(token)


def _no_results(worker: str, store: ResultStore) -> Refused:
    return Refused(
        f"{worker} does not see the results in {store}",
        "give --results a folder that all workers see under this name",
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence Dask's logs and all warnings within the block."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for logger in loggers:
            logger.setLevel(logging.CRITICAL + 1)
        try:
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)
