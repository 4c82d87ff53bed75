"""`python -m embodichain`: the same command as `embodichain`."""

import sys

from embodichain.cli import main

if __name__ == "__main__":
    sys.exit(main())
