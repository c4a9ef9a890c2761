"""Runs the suite: python -m benchmarks.murk."""

import sys

from benchmarks.murk import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
