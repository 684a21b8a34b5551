"""Write a recording whose files are complete and valid after each write."""
