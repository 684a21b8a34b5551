"""Discovered nodes, publishers and subscriptions, whose names may contain any bytes."""
