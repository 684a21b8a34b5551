"""The tap: every topic of the graph as raw bytes, for the recorder."""
