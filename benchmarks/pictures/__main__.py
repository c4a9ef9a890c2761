"""Runs the suite: python -m benchmarks.pictures."""

import sys

from benchmarks.pictures import main

if __name__ == "__main__":
    main(sys.argv[1:])
