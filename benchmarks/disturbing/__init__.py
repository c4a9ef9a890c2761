"""The parts of ``benchmarks.chaos``: the small jobs of the runners, and processes that run and disturb them."""
