"""The simulated differential-drive robot, without clock, bus and ROS."""
