"""``python -m garmentnet.cli`` is the command ``garmentnet``."""

import sys

from .app import main

sys.exit(main())
