"""The daemon's ROS nodes, one role per file. They convert and forward data, and decide nothing."""
