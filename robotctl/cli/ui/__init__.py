"""The output of commands to a terminal, and the keys from it."""
