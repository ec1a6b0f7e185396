"""Blender extension that turns an animated mesh into an armature with vertex groups and an action.

It needs only Blender's NumPy. The solver is the command ``ssdr``, which runs as a separate process
in a Python environment: one that the preferences name, or one that a button there makes.
"""

from . import ui


def register() -> None:
    ui.register()


def unregister() -> None:
    ui.unregister()
