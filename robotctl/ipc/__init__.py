"""The control socket: JSON-RPC 2.0 over a Unix socket, one object a line.

`protocol` does no I/O. `server` runs in the daemon's asyncio loop. `client` blocks, and imports
only the standard library, so that a command takes little longer than the start of Python.
"""
