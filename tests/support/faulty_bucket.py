"""An S3 server with one bucket that fails as a test wants, and counts what it is asked."""

from __future__ import annotations

import random
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import md5
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Protocol
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape

import pytest

from tests.support.s3_server import environment


class Content(Protocol):
    """The bytes of an object, which may be larger than any memory."""

    @property
    def etag(self) -> str: ...

    def __len__(self) -> int: ...

    def __getitem__(self, piece: slice) -> bytes: ...


class Stored(bytes):
    """The bytes of a small object."""

    @property
    def etag(self) -> str:
        return md5(self, usedforsecurity=False).hexdigest()


class Moved(bytes):
    """What is answered for an object that is elsewhere: its new path."""

    def __new__(cls, path: str) -> Moved:
        return super().__new__(cls, path.encode())

    @property
    def etag(self) -> str:
        return "moved"


@dataclass(frozen=True, slots=True)
class StoredFile:
    """The bytes of a file, which need not fit into memory."""

    path: Path

    @property
    def etag(self) -> str:
        return str(self.path.stat().st_mtime_ns)

    def __len__(self) -> int:
        return self.path.stat().st_size

    def __getitem__(self, piece: slice) -> bytes:
        with self.path.open("rb") as file:
            file.seek(piece.start)
            return file.read(piece.stop - piece.start)


@dataclass
class FaultyBucket:
    """The bucket `robots`; all fields may be changed while it serves."""

    endpoint: str = ""
    objects: dict[str, Content] = field(default_factory=dict)
    failing_share: float = 0.0
    """Of requests that are answered with HTTP status 503."""

    short_share: float = 0.0
    """Of answers that break off in the middle."""

    lying_size: int | None = None
    """The size that all objects claim to have."""

    latency_s: float = 0.0
    before: Callable[[FaultyBucket, str, str], int | None] = lambda bucket, method, key: None
    """Called with method and key before each answer; a returned number is its HTTP status."""

    requests: int = 0
    at_once: int = 0
    most_at_once: int = 0
    """Requests that waited for their answer at the same time."""

    sent_bytes: int = 0
    authorizations: set[str] = field(default_factory=set)
    """The headers with which requests were signed."""

    seed: int = 1

    def __post_init__(self) -> None:
        self.chance = random.Random(self.seed)
        self.lock = threading.Lock()

    def __setitem__(self, key: str, content: bytes) -> None:
        self.objects[key] = content if isinstance(content, Moved) else Stored(content)


@contextmanager
def faulty_bucket() -> Iterator[FaultyBucket]:
    """Serve an empty bucket on localhost."""
    bucket = FaultyBucket()

    class Handler(_Handler):
        pass

    Handler.bucket = bucket
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    server.block_on_close = False
    bucket.endpoint = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield bucket
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def serving(monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyBucket]:
    """Serve an empty bucket to this process and its children."""
    with faulty_bucket() as bucket:
        for name, value in environment(bucket.endpoint).items():
            monkeypatch.setenv(name, value)
        yield bucket


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    bucket: FaultyBucket

    def log_message(self, *args: object) -> None:
        pass

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        key = self._key()
        if self._failed(key):
            return
        query = parse_qs(urlsplit(self.path).query)
        if "list-type" in query:
            self._list(query.get("prefix", [""])[0])
            return
        content = self.bucket.objects.get(key)
        if content is None:
            self._answer(404, b"<Error><Code>NoSuchKey</Code></Error>")
        elif isinstance(content, Moved):
            self._answer(302, headers={"Location": content.decode()})
        elif self.headers.get("If-Match", f'"{content.etag}"') != f'"{content.etag}"':
            self._answer(412)
        else:
            self._send(content)

    def do_PUT(self) -> None:
        key = self._key()
        data = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if self._failed(key):
            return
        with self.bucket.lock:
            taken = self.headers.get("If-None-Match") == "*" and key in self.bucket.objects
            if not taken:
                self.bucket.objects[key] = Stored(data)
        if taken:
            self._answer(412)
        else:
            self._answer(200, headers={"ETag": f'"{Stored(data).etag}"'})

    def _key(self) -> str:
        path = unquote(urlsplit(self.path).path)
        return path.removeprefix("/robots").removeprefix("/")

    def _failed(self, key: str) -> bool:
        """Count a request; answer it if it has to fail."""
        bucket = self.bucket
        with bucket.lock:
            bucket.requests += 1
            bucket.authorizations.add(self.headers.get("Authorization", ""))
            failing = bucket.chance.random() < bucket.failing_share
            bucket.at_once += 1
            bucket.most_at_once = max(bucket.most_at_once, bucket.at_once)
        time.sleep(bucket.latency_s)
        with bucket.lock:
            bucket.at_once -= 1
        status = bucket.before(bucket, self.command, key)
        if status is None and failing:
            status = 503
        if status is not None:
            self._answer(status, b"<Error><Code>SlowDown</Code></Error>")
        return status is not None

    def _list(self, prefix: str) -> None:
        found = "".join(
            f"<Contents><Key>{escape(key)}</Key><Size>{self._size(content)}</Size>"
            f"<ETag>&quot;{content.etag}&quot;</ETag>"
            "<LastModified>2026-01-01T00:00:00.000Z</LastModified></Contents>"
            for key, content in self.bucket.objects.items()
            if key.startswith(prefix)
        )
        self._answer(200, f"<ListBucketResult>{found}</ListBucketResult>".encode())

    def _size(self, content: Content) -> int:
        return len(content) if self.bucket.lying_size is None else self.bucket.lying_size

    def _send(self, content: Content) -> None:
        size, wanted = self._size(content), self.headers.get("Range")
        headers = {"ETag": f'"{content.etag}"', "Last-Modified": "Thu, 01 Jan 2026 00:00:00 GMT"}
        if self.command == "HEAD":
            self._answer(200, headers=headers, length=size)
            return
        begin, end, status = 0, size, 200
        if wanted and (found := re.fullmatch(r"bytes=(\d+)-(\d+)", wanted)):
            begin, end, status = int(found[1]), min(int(found[2]) + 1, size), 206
            headers["Content-Range"] = f"bytes {begin}-{end - 1}/{size}"
        body = content[begin:end]
        with self.bucket.lock:
            self.bucket.sent_bytes += len(body)
            short = self.bucket.chance.random() < self.bucket.short_share
        self._answer(status, body[: len(body) // 2] if short else body, headers, end - begin)

    def _answer(
        self,
        status: int,
        body: bytes = b"",
        headers: dict[str, str] | None = None,
        length: int | None = None,
    ) -> None:
        self.send_response(status)
        for name, value in (headers or {}).items():
            self.send_header(name, value)
        length = len(body) if length is None else length
        self.send_header("Content-Length", str(length))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)
            self.close_connection |= len(body) != length
