"""Runs the suite: python -m benchmarks.wall_network."""

import sys

from benchmarks.wall_network import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
