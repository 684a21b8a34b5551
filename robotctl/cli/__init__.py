"""The command line: it sends requests to the daemon's socket and prints the answers."""
