"""The command line: asks the daemon over its socket and shows the answer."""
