"""The commands about recordings, one or many."""
