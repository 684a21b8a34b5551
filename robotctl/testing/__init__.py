"""Fakes for users' own tests: kernels on virtual time, drives without ROS, disks that fail.

`kernels` steps a kernel by hand, `drives` makes recordings of simulated drives, `hearing` has
a kernel that reads numbered messages, and `faults` has files that fail like disks do.
"""
