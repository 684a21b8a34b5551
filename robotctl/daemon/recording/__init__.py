"""What the daemon records, and the recordings folder that it keeps in order."""
