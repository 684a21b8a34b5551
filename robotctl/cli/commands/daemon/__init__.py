"""Commands about the daemon of a robot."""
