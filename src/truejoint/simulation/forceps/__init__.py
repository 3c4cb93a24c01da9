"""The digital twin of the one-jaw cable-driven forceps of yan2020."""
