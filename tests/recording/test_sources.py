"""A recording that is no local file: a check reads the ranges that it needs, and few of them."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.request import Request, urlopen

import pytest

from robotctl.recording import Recorder, RecorderOptions, Recording, Topic
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.store.remote_file import path_of
from robotctl.testing.drives import GID, JOURNAL, ODOMETRY, TWIST, drive, record
from tests.support.faulty_bucket import StoredFile, serving

CAMERA = Topic("/camera", "sensor_msgs/msg/CompressedImage")
IMAGE = random.Random(1).randbytes(300_000)
EVERY_NS = 33_000_000
EVIDENCE = frozenset({JOURNAL.name, TWIST.name, ODOMETRY.name})


class RangeServer(ThreadingHTTPServer):
    """Serves one file by ranges, and counts the bytes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sent = 0
        super().__init__(("127.0.0.1", 0), _Handler)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/"


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_HEAD(self) -> None:
        self._head(200, self.server.path.stat().st_size)  # type: ignore[attr-defined]

    def do_GET(self) -> None:
        first, last = map(int, self.headers["Range"].removeprefix("bytes=").split("-"))
        with self.server.path.open("rb") as file:  # type: ignore[attr-defined]
            file.seek(first)
            data = file.read(last - first + 1)
        self._head(206, len(data))
        self.wfile.write(data)
        self.server.sent += len(data)  # type: ignore[attr-defined]

    def log_message(self, *_: object) -> None:
        """Print nothing."""

    def _head(self, status: int, length: int) -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(length))
        self.end_headers()


class HttpSource:
    """A source of ranges over HTTP."""

    def __init__(self, url: str) -> None:
        self._url = url

    def size(self) -> int:
        with urlopen(Request(self._url, method="HEAD")) as answer:
            return int(answer.headers["Content-Length"])

    def stored_bytes(self) -> int:
        return self.size()

    def read(self, offset: int, length: int) -> bytes:
        if not length:
            return b""
        wanted = {"Range": f"bytes={offset}-{offset + length - 1}"}
        with urlopen(Request(self._url, headers=wanted)) as answer:
            data: bytes = answer.read()
            return data

    def is_written(self) -> bool:
        return False

    def close(self) -> None:
        """Do nothing: each range is a connection of its own."""


def camera() -> Callable[[Recorder, int], None]:
    """Return what records an image each 33 ms."""
    due_ns = 0

    def beside(recorder: Recorder, time_ns: int) -> None:
        nonlocal due_ns
        while due_ns <= time_ns:
            recorder.write(recorder.add_topic(CAMERA), IMAGE, time_ns, time_ns, 0, GID)
            due_ns = max(due_ns, time_ns) + EVERY_NS

    return beside


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a drive of 20 s beside a camera."""
    folder = tmp_path_factory.mktemp("camera") / "run"
    options = RecorderOptions(evidence=EVIDENCE, memory_bytes=1 << 30)
    record(folder, drive(20.0, snapshots_s=(0.0, 10.0)), options=options, beside=camera())
    (file,) = folder.glob("*.mcap")
    return file


@pytest.fixture
def server(recorded: Path) -> Iterator[RangeServer]:
    with RangeServer(recorded) as serving:
        thread = threading.Thread(target=serving.serve_forever, daemon=True)
        thread.start()
        yield serving
        serving.shutdown()
        thread.join()


def test_a_check_over_http_says_what_a_check_of_the_file_says(
    recorded: Path, server: RangeServer
) -> None:
    report = check_recording(Path("remote.mcap"), source=HttpSource(server.url))
    local = check_recording(recorded)
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert (report.events, report.effects, report.commands) == (
        local.events,
        local.effects,
        local.commands,
    )
    assert "not every byte was read, only what the check needs" in report.notes


def test_a_check_reads_only_a_small_part_of_a_recording_with_images(
    recorded: Path, server: RangeServer
) -> None:
    """This one has 20 s; with the minutes of a real one, the share of the index gets smaller."""
    check_recording(Path("remote.mcap"), source=HttpSource(server.url))
    assert server.sent < 0.01 * recorded.stat().st_size


def test_a_check_of_a_file_at_a_url_reads_a_small_part_of_it(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(monkeypatch) as bucket:
        bucket.objects["run.mcap"] = StoredFile(recorded)
        report = check_recording(path_of("s3://robots/run.mcap"))
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert bucket.sent_bytes < 0.1 * recorded.stat().st_size


def test_without_a_server_the_recording_cannot_be_read(recorded: Path, server: RangeServer) -> None:
    url = server.url
    server.server_close()
    report = check_recording(Path("remote.mcap"), source=HttpSource(url))
    assert report.verdict is Verdict.INCOMPLETE


def test_the_messages_of_one_topic_are_read_over_http(server: RangeServer) -> None:
    with Recording(Path("remote.mcap"), source=HttpSource(server.url)) as recording:
        found = recording.messages({JOURNAL.name}, pytest.fail)
        assert sum(1 for _ in found) == next(
            topic.message_count for topic in recording.info().topics if topic.name == JOURNAL.name
        )
