"""Runs the suite."""

import sys

from benchmarks.stones import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
