"""Ways from a cost matrix to a distance and correspondences: nearest, Sinkhorn, Hungarian, OpenCV's own."""
