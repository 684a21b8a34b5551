"""The daemon: where kernel, ROS, recorder and control socket are put together."""
