"""Blender extension that turns an animated mesh into an armature with vertex groups and an action.

It needs only Blender's NumPy. The solver runs as a separate process, by the Python that the
preferences name, in whose environment ``ssdr`` is installed.
"""

from . import ui


def register() -> None:
    ui.register()


def unregister() -> None:
    ui.unregister()
