"""Recordings played to ROS with their own timing, in a separate process: `python -m`."""
