"""``python -m bayeq``."""

import sys

from bayeq.cli import main

sys.exit(main())
