"""What commands work on: robots and their daemons, recordings, and the ROS graph."""
