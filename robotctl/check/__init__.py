"""Re-runs recorded decisions in a new kernel; `robotctl.rerun` has the names for library users."""
