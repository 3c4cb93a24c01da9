"""The digital twin of joints that several cables turn, such as an instrument's wrist."""
