"""Many recordings: an index of each, questions over all, `robotctl gate`, and copies elsewhere."""
