"""What every room may use: errors, paths, files and trust, text, processes, ROS domains, stores."""
