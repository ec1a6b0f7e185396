"""Operators, panel and preferences of the extension."""

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

from .job import Decompose, Install, Job, ShowPage, folders
from .process import AddonError, python_in

_LOOK_AROUND = {"MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM"}


def _environment() -> Path:
    return Path(bpy.utils.extension_path_user(__package__, create=True)) / "environment"


def _python(context: Any) -> Path:
    """Python named in the preferences or, if none is named, that of the environment made there."""
    named = context.preferences.addons[__package__].preferences.python
    python = Path(bpy.path.abspath(named)) if named else python_in(_environment())
    if not python.is_file():
        where = "Preferences > Add-ons > SSDR"
        if named:
            raise AddonError(f"There is no Python at {python}: see {where}")
        raise AddonError(
            f"ssdr is not installed yet: press Install in {where}, or name a Python there"
        )
    return python


class SSDR_preferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    python: StringProperty(
        name="Python",
        description="Python in which ssdr is installed; empty: the one that Install makes",
        subtype="FILE_PATH",
    )
    source: StringProperty(
        name="Install from",
        description="A wheel of ssdr, or a folder with it and all that it needs",
        subtype="FILE_PATH",
    )
    online: BoolProperty(
        name="Fetch what the wheel needs",
        description="Let pip download NumPy, SciPy, Numba and the like from its package index; "
        "otherwise no network is used, and their wheels must lie beside that of ssdr",
    )

    def draw(self, context: Any) -> None:
        self.layout.prop(self, "python")
        self.layout.prop(self, "source")
        self.layout.prop(self, "online")
        made = python_in(_environment()).is_file()
        self.layout.operator("ssdr.install", text="Install again" if made else "Install")


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
    place: EnumProperty(
        name="Place",
        items=[
            ("REPLACE", "In its stead", "The object itself gets bones in place of its animation"),
            ("BESIDE", "Beside it", "A copy gets them; the object stays as it is"),
        ],
    )
    clips: BoolProperty(
        name="Clips from markers",
        description="Each marker of the timeline starts a clip of its name, which ends before the "
        "next marker and becomes an action; otherwise all frames become one",
    )
    color_error: BoolProperty(
        name="Error as colour",
        description="Colour attribute: blue where the bones are exact, red where they are least so",
        default=True,
    )


class _Stepwise:
    """Operator that runs a job.

    Called from a script, it runs the job in one go.  From the interface, it runs the job in steps,
    which show the progress and which Esc cancels.
    """

    _job: Job
    _timer: Any = None

    def start(self, context: Any) -> Job:
        raise NotImplementedError

    def finish(self, job: Job) -> None:
        """Use the result of the job, after its last step."""

    def execute(self, context: Any) -> set[str]:
        try:
            self._job = self.start(context)
            while self._job.step():
                pass
        except AddonError as problem:
            return self._fail(problem)
        return self._succeed()

    def invoke(self, context: Any, event: Any) -> set[str]:
        try:
            self._job = self.start(context)
        except AddonError as problem:
            return self._fail(problem)
        manager = context.window_manager
        manager.progress_begin(0, 100)
        self._timer = manager.event_timer_add(0.03, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"INFO"}, "Cancelled: nothing has changed")
            return {"CANCELLED"}
        if event.type in _LOOK_AROUND:
            return {"PASS_THROUGH"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"}  # the scene must not change meanwhile
        try:
            more = self._job.step()
        except AddonError as problem:
            self._end(context)
            return self._fail(problem)
        if not more:
            self._end(context)
            return self._succeed()
        percent = 100 * self._job.fraction
        context.window_manager.progress_update(percent)
        context.workspace.status_text_set(f"{percent:.0f} %  {self._job.text}  (Esc: cancel)")
        return {"RUNNING_MODAL"}

    def cancel(self, context: Any) -> None:
        """Cancel the job; Blender also calls this when it closes the window."""
        self._job.cancel()
        self._end(context)

    def _end(self, context: Any) -> None:
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)

    def _fail(self, problem: AddonError) -> set[str]:
        self.report({"ERROR"}, str(problem))
        return {"CANCELLED"}

    def _succeed(self) -> set[str]:
        for warning in self._job.warnings:
            self.report({"WARNING"}, warning)
        self.finish(self._job)
        self.report({"INFO"}, self._job.text)
        return {"FINISHED"}


class SSDR_OT_decompose(_Stepwise, bpy.types.Operator):
    bl_idname = "ssdr.decompose"
    bl_label = "Animation to Bones"
    bl_description = "Replace the animation of the active mesh by an armature with actions"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.mode == "OBJECT"

    def start(self, context: Any) -> Job:
        return Decompose(context, context.object, context.scene.ssdr, _python(context))


class SSDR_OT_page(_Stepwise, bpy.types.Operator):
    bl_idname = "ssdr.page"
    bl_label = "Show in Browser"
    bl_description = "Open a page with the bones beside the animation that they replace"

    def start(self, context: Any) -> Job:
        return ShowPage(context.object, _python(context))

    def finish(self, job: ShowPage) -> None:
        bpy.ops.wm.url_open(url=job.page.as_uri())


class SSDR_OT_install(_Stepwise, bpy.types.Operator):
    bl_idname = "ssdr.install"
    bl_label = "Install ssdr"
    bl_description = "Make a Python environment of its own and install ssdr into it with pip"

    def start(self, context: Any) -> Job:
        chosen = context.preferences.addons[__package__].preferences
        source = bpy.path.abspath(chosen.source) if chosen.source else ""
        return Install(_environment(), source, chosen.online)


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
        for name in ("influences", "effort", "place", "clips", "color_error"):
            layout.prop(options, name)
        layout.operator("ssdr.decompose", icon="ARMATURE_DATA")
        if context.object is not None and context.object.name in folders:
            layout.operator("ssdr.page", icon="URL")


_CLASSES = (
    SSDR_preferences,
    SSDR_options,
    SSDR_OT_decompose,
    SSDR_OT_page,
    SSDR_OT_install,
    SSDR_PT_panel,
)


def register() -> None:
    for one in _CLASSES:
        bpy.utils.register_class(one)
    bpy.types.Scene.ssdr = PointerProperty(type=SSDR_options)


def unregister() -> None:
    del bpy.types.Scene.ssdr
    for one in reversed(_CLASSES):
        bpy.utils.unregister_class(one)
