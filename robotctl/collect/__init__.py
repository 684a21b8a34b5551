"""Copies finished recordings to a store of objects, and removes them here once they are there."""
