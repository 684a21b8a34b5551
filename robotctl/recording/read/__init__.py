"""Read any MCAP recording, also a damaged or hostile one."""
