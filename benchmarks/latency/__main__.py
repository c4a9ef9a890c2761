"""Runs the suite: python -m benchmarks.latency."""

import sys

from benchmarks.latency import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
