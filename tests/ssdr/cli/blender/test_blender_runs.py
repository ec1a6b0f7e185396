"""The extension's operators: Esc, what is wrong, the installation of the solver, the page."""

from __future__ import annotations

from typing import Any

from helpers.blender_scene import needs_blender


@needs_blender
def test_cancelled_in_the_middle_the_scene_is_as_it_was(blender: Any) -> None:
    said = blender("""
item = grid()
item.vertex_groups.new(name="pin").add((0, 19), 1.0, "ADD")
item.modifiers.new("Cloth", "CLOTH").settings.vertex_group_mass = "pin"
item.modifiers.new("Solidify", "SOLIDIFY")
for frame in range(1, 6):
    scene.frame_set(frame)
was, found = state(), []
for phase in ("reading the frames", "preparing", "RMSE"):
    work = job.steps(bpy.context, item, options, PYTHON)
    while phase not in next(work)[1]:
        pass
    work.close()
    alone = False
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        alone = True
    found.append([state() == was, left_behind(), alone])
print("SAID " + json.dumps(found))
""")
    assert said == 3 * [[True, [], True]]


@needs_blender
def test_what_is_wrong_is_said_in_plain_words(blender: Any) -> None:
    said = blender("""
was = left_behind()
found = {"none": error()}
still = grid()
found["still"] = error()
build = still.modifiers.new("Build", "BUILD")
found["count"] = error()
still.modifiers.remove(build)
options.joints = "ARMATURE"
found["armature"] = error()
options.joints = "NONE"
bending()
options.clips = True
found["no marker"] = error()
options.clips = False
options.bones = 5000
found["bones"] = error()
preferences.python = str(FOLDER / "nowhere" / "python")
found["python"] = error()
preferences.python = ""
found["unnamed"] = error()
found["left"] = left_behind()
print("SAID " + json.dumps(found))
""")
    for key, words in {
        "none": "Select a mesh object first: none is active",
        "still": "Grid does not move between the frames 1 and 30 of the scene",
        "count": "their number must stay the same",
        "armature": "Choose the armature whose bones to keep",
        "no marker": "Set a marker where each clip starts, between the frames 1 and 30",
        "bones": "bones: expected an integer from 1 to",
        "python": "There is no Python at",
        "unnamed": "name one in which ssdr is installed in Preferences",
    }.items():
        assert words in said[key], key
        assert said[key].startswith("Error: "), key
        assert "\n" not in said[key], key
    assert said["left"] == []
