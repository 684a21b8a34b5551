"""A differential-drive robot that moves without a clock, a bus or a real floor."""
