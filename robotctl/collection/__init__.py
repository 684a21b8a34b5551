"""Many recordings: an index of each, questions over all, `robotctl gate`, and `robotctl sync`."""
