"""Studies on recordings of real joints that laboratories published."""
