"""ROS bags: what is in them, recordings out of them, and recordings written as bags."""
