"""Copies of recordings in another form: other files, another compression, from sqlite3."""
