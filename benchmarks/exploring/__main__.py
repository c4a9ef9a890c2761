"""Runs the suite: python -m benchmarks.exploring."""

import sys

from benchmarks.exploring import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
