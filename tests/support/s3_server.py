"""A real S3 server of this process, and the environment of a client that uses it."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Final
from urllib.request import Request, urlopen

Application = Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]
"""A server of WSGI."""


def works(application: Application) -> Application:
    """Let every request succeed."""
    return application


class Failing:
    """Answers a share of the requests, and the first of each kind, with HTTP status 503.

    Half of those requests are done all the same: only their answer is lost.
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


def environment(endpoint: str) -> dict[str, str]:
    """Return what a user sets for a server without https at `endpoint`."""
    return {
        "AWS_ENDPOINT_URL": endpoint,
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "AKIDEXAMPLE",
        "AWS_SECRET_ACCESS_KEY": "very-secret",
        "AWS_REGION": "us-east-1",
    }


@contextmanager
def s3_server(within: Callable[[Application], Application] = works) -> Iterator[str]:
    """Serve S3 on localhost with an empty bucket `robots`; yield the endpoint.

    Once the bucket is there, the requests go to `within` the server.
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
