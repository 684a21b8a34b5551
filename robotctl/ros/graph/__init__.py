"""Who is on the ROS graph: publishers, subscriptions and nodes, with any bytes as names."""
