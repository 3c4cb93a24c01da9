"""The judge of recordings and links; `truejoint.recordings.check_data` runs its parts."""
