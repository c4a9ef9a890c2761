"""Runs the suite: python -m benchmarks.still_pixels."""

import sys

from benchmarks.still_pixels import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
