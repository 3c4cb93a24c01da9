"""stack: what runs, and what learns."""
