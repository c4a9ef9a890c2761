"""EM trackers: one driver a file."""
