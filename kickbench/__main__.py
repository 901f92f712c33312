"""`python -m kickbench`: the command line, also of the runs that `kickbench reproduce` starts."""

import sys

from kickbench.cli import main
from kickbench.launch.process import die_with_parent

if __name__ == "__main__":
    die_with_parent()
    sys.exit(main())
