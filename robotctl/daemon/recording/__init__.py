"""The recording that the daemon makes, and the recordings folder that it manages."""
