"""``python -m ssdr`` is the command ``ssdr``."""

import sys

from .cli import main

sys.exit(main())
