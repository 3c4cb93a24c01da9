"""gp: what runs, and what learns."""
