"""`python -m feel321`: the command line."""

import sys

from feel321.study.cli import main

if __name__ == "__main__":
    sys.exit(main())
