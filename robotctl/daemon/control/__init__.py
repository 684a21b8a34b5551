"""Input becomes an event, the kernel decides on it, and its effects are carried out."""
