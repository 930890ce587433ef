"""Runs the command line as `python -m cosim`."""

import sys

from cosim.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
