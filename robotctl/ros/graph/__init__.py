"""Discovered nodes, publishers and subscriptions, whose names may hold any bytes."""
