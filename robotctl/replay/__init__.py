"""Recordings played to ROS with their own timing, by a process of its own: `python -m`."""
