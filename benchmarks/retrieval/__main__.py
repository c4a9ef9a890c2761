"""Runs the suite: python -m benchmarks.retrieval."""

import sys

from benchmarks.retrieval import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
