"""The contents of a recording's files: MCAP records, rosbag2 metadata, the journal."""
