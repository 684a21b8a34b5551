"""CDR, the serialized form of ROS messages (OMG DDSI-RTPS 10.2), read and written without ROS."""
