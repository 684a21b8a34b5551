"""Converts recordings: to other files, to another compression, from sqlite3 to MCAP."""
