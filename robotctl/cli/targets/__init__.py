"""The targets of commands: robots and their daemons, recordings, and the ROS graph."""
