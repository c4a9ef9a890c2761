"""Runs the suite: python -m benchmarks.population."""

import sys

from benchmarks.population import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
