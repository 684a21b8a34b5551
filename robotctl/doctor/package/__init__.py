"""The classic mistakes of a first ROS 2 package, from its files: nothing of it is imported."""
