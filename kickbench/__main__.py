"""`python -m kickbench`."""

import sys

from kickbench.cli import main

if __name__ == "__main__":
    sys.exit(main())
