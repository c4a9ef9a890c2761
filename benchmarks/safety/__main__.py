"""Runs the suite: python -m benchmarks.safety."""

import sys

from benchmarks.safety import main

if __name__ == "__main__":
    main(sys.argv[1:])
