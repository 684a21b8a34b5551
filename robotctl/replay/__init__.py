"""Plays recordings to ROS with their timing, in a process of its own."""
