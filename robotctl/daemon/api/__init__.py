"""The methods of the control socket, one file for each group."""
