"""Commands about many recordings."""
