"""The simulated differential-drive robot, without a clock, a bus or ROS."""
