"""A recording as one HTML page: what was driven, what was decided, and what proves it. No ROS."""
