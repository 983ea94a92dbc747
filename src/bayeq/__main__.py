"""``python -m bayeq``."""

import sys

from bayeq.cli.process import run

if __name__ == "__main__":  # worker processes import it under another name
    sys.exit(run())
