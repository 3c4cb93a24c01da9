"""plays: what runs, and what learns."""
