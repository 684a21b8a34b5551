"""Draws recordings without ROS: a report as one HTML page, and figures as SVG, PNG and text."""
