"""What the journal of decisions tells about a robot, as one report."""
