"""The operator, the panel and the preferences of the extension."""

import traceback
from pathlib import Path
from typing import Any, ClassVar

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from .job import steps
from .process import AddonError

_LOOK_AROUND = {"MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM"}


class SSDR_preferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    python: StringProperty(
        name="Python",
        description="Python of an environment in which ssdr is installed",
        subtype="FILE_PATH",
    )

    def draw(self, context: Any) -> None:
        self.layout.prop(self, "python")


class SSDR_options(bpy.types.PropertyGroup):
    size: EnumProperty(
        name="Size",
        items=[
            ("BONES", "Bones", "As many bones as you say"),
            ("TOLERANCE", "Tolerance", "As few bones as the error allows"),
        ],
    )
    bones: IntProperty(name="Bones", default=24, min=1, soft_max=256)
    tolerance: FloatProperty(
        name="Error",
        description="Percent of the diagonal of the mesh's bounding box",
        default=0.5,
        min=1e-4,
        soft_max=10,
        precision=3,
        subtype="PERCENTAGE",
    )
    measure: EnumProperty(
        name="Of",
        items=[
            ("RMSE", "All vertices", "The root mean square error"),
            ("MAX", "Each vertex", "The error of every vertex in every frame"),
        ],
    )
    influences: IntProperty(
        name="Influences", description="Most bones that move one vertex", default=4, min=1, max=16
    )
    effort: EnumProperty(
        name="Effort",
        items=[("FAST", "Fast", ""), ("BALANCED", "Balanced", ""), ("BEST", "Best", "")],
        default="BALANCED",
    )
    joints: EnumProperty(
        name="Hierarchy",
        items=[
            ("NONE", "None", "Free bones: the smallest error"),
            ("LOOSE", "Loose", "A tree whose joints may come apart"),
            ("RIGID", "Rigid", "A tree whose bones turn about their joints: can be posed"),
            ("ARMATURE", "Armature", "The names and the tree of an armature's deforming bones"),
        ],
    )
    armature: PointerProperty(
        name="Armature", type=bpy.types.Object, poll=lambda _, item: item.type == "ARMATURE"
    )
    clips: BoolProperty(
        name="Clips from markers",
        description="Each marker of the timeline starts a clip of its name, which ends before the "
        "next marker and becomes an action; otherwise all frames become one",
    )


class SSDR_OT_decompose(bpy.types.Operator):
    """Operator that does the work in one go if a script calls it.

    From the interface it works in steps, which show the progress and which Esc cancels.
    """

    bl_idname = "ssdr.decompose"
    bl_label = "Animation to Bones"
    bl_description = "Replace the animation of the active mesh by an armature with actions"
    bl_options: ClassVar = {"REGISTER", "UNDO"}
    _steps: Any = None
    _said: tuple[float, str] = (0.0, "starting")
    _timer: Any = None

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.mode == "OBJECT"

    def _start(self, context: Any) -> Any:
        named = context.preferences.addons[__package__].preferences.python
        python = Path(bpy.path.abspath(named))
        if not named or not python.is_file():
            where = "name one in which ssdr is installed in Preferences > Add-ons > SSDR"
            raise AddonError(f"There is no Python at {named}: {where}")
        return steps(context, context.object, context.scene.ssdr, python)

    def _step(self, context: Any) -> set[str]:
        """Do the next step, and return what Blender is to do."""
        try:
            self._steps = self._steps or self._start(context)
            self._said = next(self._steps)
        except StopIteration as end:
            for warning in end.value:
                self.report({"WARNING"}, warning)
            self.report({"INFO"}, self._said[1])
            return {"FINISHED"}
        except Exception as error:
            if not isinstance(error, AddonError):
                traceback.print_exc()
            name = "" if isinstance(error, AddonError) else f"{type(error).__name__}: "
            self.report({"ERROR"}, f"{name}{error}")
            return {"CANCELLED"}
        return {"RUNNING_MODAL"}

    def execute(self, context: Any) -> set[str]:
        state = {"RUNNING_MODAL"}
        while state == {"RUNNING_MODAL"}:
            state = self._step(context)
        return state

    def invoke(self, context: Any, event: Any) -> set[str]:
        state, manager = self._step(context), context.window_manager
        if state == {"RUNNING_MODAL"}:
            manager.progress_begin(0, 100)
            self._timer = manager.event_timer_add(0.03, window=context.window)
            manager.modal_handler_add(self)
        return state

    def modal(self, context: Any, event: Any) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"INFO"}, "Cancelled: nothing has changed")
            return {"CANCELLED"}
        if event.type in _LOOK_AROUND:
            return {"PASS_THROUGH"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"}  # the scene must not change meanwhile
        state, (done, text) = self._step(context), self._said
        if state == {"RUNNING_MODAL"}:
            context.window_manager.progress_update(100 * done)
            context.workspace.status_text_set(f"{100 * done:.0f} %  {text}  (Esc: cancel)")
        else:
            self._end(context)
        return state

    def cancel(self, context: Any) -> None:
        """Cancel the work; Blender also calls this when it closes the window."""
        self._steps.close()
        self._end(context)

    def _end(self, context: Any) -> None:
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)


class SSDR_PT_panel(bpy.types.Panel):
    bl_label = "Animation to Bones"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SSDR"

    def draw(self, context: Any) -> None:
        layout, options = self.layout, context.scene.ssdr
        layout.use_property_split = True
        layout.prop(options, "joints")
        if options.joints == "ARMATURE":
            layout.prop(options, "armature")
        else:
            layout.prop(options, "size", expand=True)
            for name in ("bones",) if options.size == "BONES" else ("tolerance", "measure"):
                layout.prop(options, name)
        for name in ("influences", "effort", "clips"):
            layout.prop(options, name)
        layout.operator("ssdr.decompose", icon="ARMATURE_DATA")


_CLASSES = SSDR_preferences, SSDR_options, SSDR_OT_decompose, SSDR_PT_panel


def register() -> None:
    for one in _CLASSES:
        bpy.utils.register_class(one)
    bpy.types.Scene.ssdr = PointerProperty(type=SSDR_options)


def unregister() -> None:
    del bpy.types.Scene.ssdr
    for one in reversed(_CLASSES):
        bpy.utils.unregister_class(one)
