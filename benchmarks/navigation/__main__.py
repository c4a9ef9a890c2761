"""Runs the suite: python -m benchmarks.navigation."""

import sys

from benchmarks.navigation import main

if __name__ == "__main__":
    main(sys.argv[1:])
