"""Checks of this computer and of its ROS graph; each problem comes with a cure."""
