"""Runs the suite: python -m benchmarks.causes."""

import sys

from benchmarks.causes import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
