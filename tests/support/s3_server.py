"""A real S3 server of this process, and the environment of a client that uses it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from urllib.request import Request, urlopen


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
def s3_server() -> Iterator[str]:
    """Serve S3 on localhost with an empty bucket `robots`; yield the endpoint."""
    from moto.server import ThreadedMotoServer  # importing it takes 0.4 s

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        endpoint = f"http://{host}:{port}"
        with urlopen(Request(f"{endpoint}/robots", method="PUT"), timeout=10):
            yield endpoint
    finally:
        server.stop()
