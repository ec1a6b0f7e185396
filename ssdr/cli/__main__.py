"""``python -m ssdr.cli`` is the command ``ssdr``."""

import sys

from . import main

sys.exit(main())
