"""The ROS nodes of the daemon: one role, one file."""
