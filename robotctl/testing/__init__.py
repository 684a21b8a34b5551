"""Clocks, files and robots for tests: they fail on demand and keep time by hand."""
