"""Many recordings: an index of each, questions over all of them, the gate, and copies elsewhere."""
