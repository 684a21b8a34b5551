"""Reads any MCAP recording, damaged and hostile ones too."""
