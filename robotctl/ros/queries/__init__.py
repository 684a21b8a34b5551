"""A process of its own that looks at ROS for a command: `python -m robotctl.ros.queries`.

The daemon's loop and the command's own process stay free of what it does: it imports rclpy, joins
the domain, waits for discovery, and loads foreign types.
"""
