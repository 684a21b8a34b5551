"""The pure core: modes, safety, patterns, tracking, limits. No clock, no I/O, no ROS."""
