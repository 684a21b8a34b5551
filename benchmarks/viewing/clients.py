"""Clients of the protocol on plain sockets: cheap, so that the server is what is measured."""

from __future__ import annotations

import json
import os
import selectors
import socket
import struct
import threading
import time

from viewing.servers import TOKEN

_MASK = b"\0\0\0\0"
_HEAD = struct.Struct("<BIQ")
_RECEIVE_BYTES = 1 << 18


class Client:
    """A connection that subscribes to the one channel."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10.0)
        self._rest = b""
        lines = (
            f"GET /?token={TOKEN} HTTP/1.1",
            f"Host: 127.0.0.1:{port}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            f"Sec-WebSocket-Key: {'A' * 22}==",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Protocol: foxglove.sdk.v1",
        )
        self.socket.sendall("\r\n".join([*lines, "", ""]).encode())
        while b"\r\n\r\n" not in self._rest:
            self._rest += self.socket.recv(_RECEIVE_BYTES)
        answer, _, self._rest = self._rest.partition(b"\r\n\r\n")
        if b" 101 " not in answer:
            raise RuntimeError(answer.decode())
        channel = None
        while channel is None:
            channel = self._channel()
        wanted = [{"id": 1, "channelId": channel}]
        text = json.dumps({"op": "subscribe", "subscriptions": wanted}).encode()
        self.socket.sendall(bytes((0x81, 0x80 | len(text))) + _MASK + text)

    def frames(self) -> list[bytes]:
        """Return the content of the whole frames that have come; receive once if there is none."""
        return self._whole() or self._whole(self.socket.recv(_RECEIVE_BYTES))

    def _whole(self, data: bytes = b"") -> list[bytes]:
        self._rest += data
        found: list[bytes] = []
        while len(self._rest) >= 2:
            length, begin = self._rest[1], 2
            if length == 126:
                length, begin = int.from_bytes(self._rest[2:4], "big"), 4
            elif length == 127:
                length, begin = int.from_bytes(self._rest[2:10], "big"), 10
            if len(self._rest) < begin + length:
                break
            found.append(self._rest[begin : begin + length])
            self._rest = self._rest[begin + length :]
        return found

    def _channel(self) -> int | None:
        for frame in self.frames():
            if frame.startswith(b"{"):
                for channel in json.loads(frame).get("channels", ()):
                    return int(channel["id"])
        return None


def latencies_of(client: Client, ended: threading.Event, found: list[float]) -> None:
    """Receive until `ended`; add the age of each message in milliseconds."""
    client.socket.settimeout(0.2)
    while not ended.is_set():
        try:
            frames = client.frames()
        except TimeoutError:
            continue
        now_ns = time.time_ns()
        stamps_ns = (_HEAD.unpack_from(frame)[2] for frame in frames if frame[:1] == b"\x01")
        found += [(now_ns - stamp_ns) / 1e6 for stamp_ns in stamps_ns]


def drain(clients: list[Client], ended: threading.Event) -> None:
    """Receive and forget until `ended`, in a process of its own."""
    pid = os.fork()
    if pid == 0:
        with selectors.DefaultSelector() as selector:
            for client in clients:
                selector.register(client.socket, selectors.EVENT_READ)
            while os.getppid() != 1:
                for key, _ in selector.select(0.2):
                    if not key.fileobj.recv(_RECEIVE_BYTES):  # type: ignore[union-attr]
                        os._exit(0)
        os._exit(0)
    ended.wait()
    os.kill(pid, 9)
    os.waitpid(pid, 0)
