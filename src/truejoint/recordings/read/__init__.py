"""Readers of recordings: text, arrays, ROS bags, public data sets."""
