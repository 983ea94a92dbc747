"""``python -m bayeq``."""

import sys

from bayeq.cli.app import main

sys.exit(main())
