"""The commands, each in a file that is named like it."""
