"""Commands that look at ROS."""
