"""motor_side: what runs, and what learns."""
