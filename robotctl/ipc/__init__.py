"""The control socket: JSON-RPC 2.0 over a Unix socket, one JSON object per line.

`protocol` does no I/O on messages. `server` runs in the daemon's asyncio loop. `client` blocks; it
needs only the standard library, so that a command takes little longer than the start of Python.
"""
