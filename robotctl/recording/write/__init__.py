"""Writes a recording that is complete and valid after each write."""
