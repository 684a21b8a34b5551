"""Commands about a recording."""
