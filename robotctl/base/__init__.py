"""Errors, paths, files and trust, text, processes, domains and stores, for all packages."""
