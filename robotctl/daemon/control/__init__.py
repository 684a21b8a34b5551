"""Events for the kernel, its decisions, and their execution."""
