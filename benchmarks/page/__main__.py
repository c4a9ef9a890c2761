"""Runs the suite: python -m benchmarks.page."""

import sys

from benchmarks.page import main

if __name__ == "__main__":
    main(sys.argv[1:])
