"""The control socket: JSON-RPC 2.0 over a Unix socket, one JSON object per line.

`server` runs in the daemon's asyncio loop. `client` blocks, and imports only the standard library.
"""
