"""What is wrong with this computer, its ROS graph, or a ROS package: findings with their cures."""
