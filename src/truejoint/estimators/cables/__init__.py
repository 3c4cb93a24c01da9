"""cables: what runs, and what learns."""
