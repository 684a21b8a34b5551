"""The live view: topics of a domain, for Foxglove and Lichtblick, over a guarded WebSocket.

- `foxglove`: the protocol, as bytes out and requests in.
- `admission`: who may connect; `viewer`: one connection, and its bounded send queue.
- `server`: all viewers, the channels, and the socket.
- `live_view`: feeds the server with the topics of a ROS domain.
- `remote_control`: what viewers may do to the robot with `--control`.
- `serving`, `__main__`: the process around them, started by `robotctl view`.

Only `viewer` needs the `websockets` package, the extra `[view]`.
"""
