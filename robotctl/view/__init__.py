"""The live view: topics of a domain, for Foxglove and Lichtblick, over a guarded WebSocket.

- `foxglove`: the protocol, as bytes out and requests in.
- `viewer`: one connection: who may connect, and its bounded send queue.
- `server`: all viewers, the channels, and the socket.
- `remote_control`: what viewers may do to the robot with `--control`.
- `serving`, `__main__`: the process, started by `robotctl view`, with the topics of a ROS domain.

Only `viewer` needs the `websockets` package, the extra `[view]`.
"""
