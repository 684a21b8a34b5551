"""Stores of objects for tests: in memory, an S3 bucket with chosen faults, and an S3 server.

`MemoryStore` is an `ObjectStore`. `FaultyBucket` counts its requests.
"""

from __future__ import annotations

import hashlib
import random
import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, unquote, urlsplit
from urllib.request import Request, urlopen
from xml.sax.saxutils import escape

import pytest

from robotctl.base.store.objects import (
    NoSuchObject,
    ObjectChanged,
    ObjectStore,
    Stamp,
    StoredObject,
)


def works(request: str, key: str) -> None:
    """Do nothing, so that the request succeeds."""


NO_STAMP = Stamp()


def content(store: ObjectStore, key: str) -> bytes:
    """Return a whole object."""
    found = store.head(key)
    return store.get_range(found, 0, found.size_bytes)


class MemoryStore:
    """An `ObjectStore`; `before(request, key)` is called at each request and may raise."""

    name = "memory"

    def __init__(self, before: Callable[[str, str], None] = works) -> None:
        self.objects: dict[str, bytes] = {}
        self.stamps: dict[str, Stamp] = {}
        self.requests: list[tuple[str, str]] = []
        self.before = before

    def _request(self, request: str, key: str) -> None:
        self.requests.append((request, key))
        self.before(request, key)

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        self._request("list", prefix)
        for key in list(self.objects):
            if not prefix or key.startswith(f"{prefix}/"):
                yield self._described(key)

    def head(self, key: str) -> StoredObject:
        self._request("head", key)
        return self._described(key)

    def get_range(self, found: StoredObject, begin: int, end: int) -> bytes:
        self._request("get", found.key)
        if self._described(found.key) != found:
            raise ObjectChanged(f"memory/{found.key} was changed while it was read")
        return self.objects[found.key][begin:end]

    def put_if_absent(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> bool:
        data = b"".join(parts)
        if key in self.objects:
            self._request("put", key)
            return False
        self._store(key, data, stamp)
        return True

    def put(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> None:
        self._store(key, b"".join(parts), stamp)

    def _store(self, key: str, data: bytes, stamp: Stamp) -> None:
        self._request("put", key)
        self.objects[key], self.stamps[key] = data, stamp

    def puts(self) -> Sequence[str]:
        """Return the keys of all requests that stored something."""
        return [key for request, key in self.requests if request == "put"]

    def _described(self, key: str) -> StoredObject:
        if key not in self.objects:
            raise NoSuchObject(f"memory/{key} does not exist")
        data = self.objects[key]
        stamp = self.stamps.get(key, NO_STAMP)
        etag = hashlib.sha1(data).hexdigest()
        return StoredObject(key, len(data), etag, stamp.modified_ns, stamp.sha256)


def environment(endpoint: str) -> dict[str, str]:
    """Return the variables that a user sets for an S3 server without https at `endpoint`."""
    return {
        "AWS_ENDPOINT_URL": endpoint,
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "AKIDEXAMPLE",
        "AWS_SECRET_ACCESS_KEY": "very-secret",
        "AWS_REGION": "us-east-1",
    }


class Stored(bytes):
    """The bytes of a small object."""

    @property
    def etag(self) -> str:
        return hashlib.md5(self, usedforsecurity=False).hexdigest()


class Moved(bytes):
    """The path to which a request for a moved object is redirected."""

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


Content = Stored | Moved | StoredFile


@dataclass
class FaultyBucket:
    """The bucket `robots`; all fields may be changed while the server runs."""

    endpoint: str = ""
    objects: dict[str, Content] = field(default_factory=dict)
    failing_share: float = 0.0
    """The share of requests that get HTTP status 503."""

    short_share: float = 0.0
    """The share of responses that end in the middle of their body."""

    lying_size: int | None = None
    """The size that all objects claim to have."""

    latency_s: float = 0.0
    before: Callable[[FaultyBucket, str, str], int | None] = lambda bucket, method, key: None
    """Called with method and key before each answer; a returned number is its HTTP status."""

    requests: int = 0
    at_once: int = 0
    most_at_once: int = 0
    """The most requests that waited for their response at the same time."""

    sent_bytes: int = 0
    authorizations: set[str] = field(default_factory=set)
    """The Authorization headers of all requests."""

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

    handler = type("Handler", (_Handler,), {"bucket": bucket})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
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
        """Count a request, and respond if it has to fail; return whether it failed."""
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


Application = Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]
"""A WSGI application."""


class Failing:
    """A WSGI application that fails a share of the requests, and the first of each kind.

    They get HTTP status 503. Half of them are executed all the same: only the response is lost.
    """

    _SHARE: Final = 0.05

    def __init__(self, application: Application) -> None:
        self._application = application
        self._chance = random.Random(17)
        self._lock = threading.Lock()
        self.kinds: dict[str, int] = {}
        """Failures by method and the names in the query."""

        self.requests = 0

    def __call__(self, request: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        names = sorted(each.partition("=")[0] for each in request["QUERY_STRING"].split("&"))
        kind = " ".join((request["REQUEST_METHOD"], *names)).strip()
        with self._lock:
            self.requests += 1
            fails = kind not in self.kinds or self._chance.random() < self._SHARE
            self.kinds[kind] = self.kinds.get(kind, 0) + fails
            is_done = self._chance.random() < 0.5
        if not fails:
            return self._application(request, start)
        if is_done:
            b"".join(self._application(request, lambda *_: None))
        else:
            request["wsgi.input"].read(int(request.get("CONTENT_LENGTH") or 0))
        start("503 Slow Down", [("Content-Length", "0")])
        return [b""]


@contextmanager
def s3_server(
    within: Callable[[Application], Application] = lambda server: server,
) -> Iterator[str]:
    """Serve S3 on localhost with an empty bucket `robots`; yield the endpoint.

    After the bucket was made, `within` may wrap the server's WSGI application.
    """
    from moto.server import ThreadedMotoServer  # importing it takes 0.4 s

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        endpoint = f"http://{host}:{port}"
        with urlopen(Request(f"{endpoint}/robots", method="PUT"), timeout=10):
            pass
        assert server._server is not None
        server._server.app = within(server._server.app)
        yield endpoint
    finally:
        server.stop()
