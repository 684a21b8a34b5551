"""ROS message types: their classes, definitions and hashes, and QoS profiles."""
