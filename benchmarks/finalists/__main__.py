"""Runs the suite: python -m benchmarks.finalists."""

import sys

from benchmarks.finalists import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
