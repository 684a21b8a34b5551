"""Text, tables and pictures for the terminal."""
