"""The parts of the data check; `truejoint.recordings.check_data` runs them."""
