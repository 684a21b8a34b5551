"""A separate process that queries ROS for one command: `python -m robotctl.ros.queries`.

It imports rclpy, joins the domain, waits for discovery and loads foreign types. None of this
then happens in the daemon's loop or in the command's own process.
"""
