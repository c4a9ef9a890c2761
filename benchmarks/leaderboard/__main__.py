"""Runs the suite: python -m benchmarks.leaderboard."""

import sys

from benchmarks.leaderboard import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
