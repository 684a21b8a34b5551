"""The tap: subscribes to every topic of the graph and hands over serialized messages."""
