"""ROS messages and their types: to and from bytes, values and texts."""
