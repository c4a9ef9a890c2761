"""The parts of ``benchmarks.fuzz``: which readers there are, what they are fed, and the process that feeds them."""
