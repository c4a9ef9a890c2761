"""The scope followed through a video: Bayesian filter, alignment, smoothing, and whether this is the kidney at all.

That the kidney breathes past the scope is not estimated beside the pose: flights without it are tracked no better
(``python -m benchmarks.flights half=choosing breathless=true``).
"""
