"""The command line: commands query the daemon's socket, ROS or recordings, and print answers."""
