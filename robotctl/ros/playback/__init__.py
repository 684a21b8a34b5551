"""Recorded messages published on ROS again."""
