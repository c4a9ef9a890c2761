"""The scope followed through a video: Bayesian filter, alignment, smoothing, and whether this is the kidney at all."""
