"""The sources of callbacks: one file for each kind of entity."""
