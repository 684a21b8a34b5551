"""What the files of a recording hold: MCAP records, rosbag2 metadata, the journal."""
