"""The control socket: JSON-RPC 2.0 over a Unix socket, one JSON object per line.

`protocol` encodes and parses messages, and sends none. `server` runs in the daemon's asyncio loop.
`client` blocks. It imports only the standard library, so that a command starts fast.
"""
