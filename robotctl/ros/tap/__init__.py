"""Subscribes to every topic of the graph, and passes the serialized messages to sinks."""
