"""Runs the suite: python -m benchmarks.session."""

import sys

from benchmarks.session import main

if __name__ == "__main__":
    main(sys.argv[1:])
