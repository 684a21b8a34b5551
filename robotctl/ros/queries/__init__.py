"""A separate process that queries ROS for one command: `python -m robotctl.ros.queries`.

It imports rclpy, joins the domain, waits for discovery and loads types of other packages, so that
neither the daemon's loop nor the command's own process has to.
"""
