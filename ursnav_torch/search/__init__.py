"""Every view of the VID compared with a picture: scan at every roll and tilt, shapes of the best, ranked hypotheses."""
