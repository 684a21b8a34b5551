"""The daemon process: connects kernel, ROS, recorder and control socket."""
