"""Time shifts between signals, and truth from another file joined to a recording."""
