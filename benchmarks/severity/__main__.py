"""Runs the suite: python -m benchmarks.severity."""

import sys

from benchmarks.severity import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
