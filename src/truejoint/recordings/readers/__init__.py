"""One module per file layout; `truejoint.recordings.formats` finds them by name."""
