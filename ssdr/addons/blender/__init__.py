"""Blender extension that turns an animated mesh into an armature with vertex groups and an action.

It needs Blender's own NumPy alone: the solver runs as a process of its own, the command ``ssdr`` in
a Python environment that the preferences name or the button there makes.
"""

from . import ui


def register() -> None:
    ui.register()


def unregister() -> None:
    ui.unregister()
