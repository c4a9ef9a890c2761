"""Runs the suite: python -m benchmarks.own_kidney."""

import sys

from benchmarks.own_kidney import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
