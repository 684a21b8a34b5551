"""Many recordings: an index beside each, and questions over all of them. Needs duckdb, no ROS."""
