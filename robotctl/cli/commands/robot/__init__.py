"""Commands to the robot."""
