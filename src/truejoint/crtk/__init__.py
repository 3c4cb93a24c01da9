"""truejoint.crtk."""
