"""robotctl drives a ROS 2 robot, stops it safely, records everything and can prove why."""

__version__ = "0.2.0"
