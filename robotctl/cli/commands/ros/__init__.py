"""Commands that query ROS."""
