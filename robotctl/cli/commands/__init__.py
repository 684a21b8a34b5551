"""The commands, each in a module or package with its name."""
