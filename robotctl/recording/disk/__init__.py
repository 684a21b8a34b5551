"""Files on the disk: access rights, positioned writes, errors."""
