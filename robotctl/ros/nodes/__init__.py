"""The ROS nodes of the daemon, one role per file: they convert and forward, and decide nothing."""
