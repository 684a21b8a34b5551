"""What the control socket offers: one file for each group of methods."""
