"""Studies of a wristed instrument: pitch and two jaws whose cables pull on each other."""
