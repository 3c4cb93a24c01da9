"""polynomial: what runs, and what learns."""
