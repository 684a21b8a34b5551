"""Work on existing recordings: list, repair, recover, clip, remove."""
