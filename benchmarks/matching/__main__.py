"""Runs the suite: python -m benchmarks.matching."""

import sys

from benchmarks.matching import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
