"""truejoint tells where a cable-driven joint really is."""
