"""What is wrong with this computer or its ROS graph: findings with their cures."""
