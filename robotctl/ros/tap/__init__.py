"""The tap: subscribes to every topic of the graph and passes serialized messages to sinks."""
