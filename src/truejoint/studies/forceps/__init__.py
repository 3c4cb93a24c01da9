"""What the studies of the forceps compute, a module each, and what they share."""
