"""From input to effect: events for the kernel, its decisions, and how these are carried out."""
