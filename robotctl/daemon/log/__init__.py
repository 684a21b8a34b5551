"""The log of the daemon: lines for a terminal, written without holding up the loop."""
