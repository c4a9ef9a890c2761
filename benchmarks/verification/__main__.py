"""Runs the suite: python -m benchmarks.verification."""

import sys

from benchmarks.verification import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
