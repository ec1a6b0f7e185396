"""Run by the Python of a new environment that holds ssdr's wheel alone."""

from __future__ import annotations

import importlib.util
import sys

import ssdr

ssdr.samples.load("dancer_small")
uninvited = [name for name in ("torch", "garmentnet", "bpy", "sksparse") if name in sys.modules]
present = [name for name in ("torch", "garmentnet", "bpy") if importlib.util.find_spec(name)]
if uninvited or present:
    raise SystemExit(f"ssdr brought {uninvited + present}")
print(f"ssdr {ssdr.__version__} from {ssdr.__path__[0]}")
