"""``python -m benchmarks.certainty``."""

import sys

from benchmarks.certainty import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
