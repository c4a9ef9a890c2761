"""Is the lens found that others found in the same pictures? See ``benchmarks.endocal.__main__``."""
