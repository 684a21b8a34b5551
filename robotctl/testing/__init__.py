"""Fakes for users' own tests: kernels on virtual time, drives without ROS, disks that fail."""
