"""Publishes recorded messages on ROS again."""
