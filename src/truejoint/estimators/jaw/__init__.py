"""jaw: what runs, and what learns."""
