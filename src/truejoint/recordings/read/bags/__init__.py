"""ROS bags: list, read and write them."""
