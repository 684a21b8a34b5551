"""Types and values of ROS messages, read and written without ROS (CDR: OMG DDSI-RTPS 10.2)."""
