"""Plays recordings to ROS with their timing, in a separate process (`-m robotctl.replay`)."""
