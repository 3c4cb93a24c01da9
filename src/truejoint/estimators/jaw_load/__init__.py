"""jaw_load: what runs, and what learns."""
