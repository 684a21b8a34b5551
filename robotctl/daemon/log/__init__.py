"""The log of the daemon: lines safe for a terminal, written without blocking the loop."""
