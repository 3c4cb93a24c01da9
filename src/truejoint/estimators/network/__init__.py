"""network: what runs, and what learns."""
