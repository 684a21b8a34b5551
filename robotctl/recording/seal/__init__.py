"""The keys of a robot, and what it signed: see `keyring`."""
