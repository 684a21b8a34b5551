"""What happens to recordings afterwards: lists, repair, recovery, clips, removal."""
