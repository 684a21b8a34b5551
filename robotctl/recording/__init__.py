"""The flight recorder: an always-valid MCAP file, its reader, and its repair. Knows no ROS."""
