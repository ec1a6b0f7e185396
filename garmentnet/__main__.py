"""``python -m garmentnet`` is the command ``garmentnet``."""

import sys

from .cli import main

sys.exit(main())
