"""The control socket: JSON-RPC 2.0 over a Unix socket, one JSON object per line.

`protocol` encodes and parses messages, and sends none. `server` runs in the daemon's asyncio loop.
`client` blocks, and imports no library but the standard one, so that a command starts fast.
"""
