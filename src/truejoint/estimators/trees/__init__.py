"""trees: what runs, and what learns."""
