"""`python -m kickbench`: the command line."""

import sys

from kickbench.cli import main

if __name__ == "__main__":
    sys.exit(main())
