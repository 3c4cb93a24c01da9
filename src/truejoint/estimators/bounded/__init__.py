"""bounded: what runs, and what learns."""
