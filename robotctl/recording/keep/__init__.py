"""What robotctl does with existing recordings: list, repair, recover, clip, remove."""
