"""Commands that need no robot."""
