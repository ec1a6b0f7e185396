"""A garment on an animated armature in Blender, predicted frame by frame from its ONNX file.

    garmentnet export dress -o dress.onnx
    garmentnet predict dress walk.npz -o dress.glb
    blender -b --python docs/examples/blender_live.py -- dress.onnx dress.glb live.npz

The .glb brings an armature whose bones are named as the body's joints; any other with those names
and that rest pose will do.  Blender's Python needs onnxruntime; a Python with the packages bpy and
onnxruntime runs the script as well.  live.npz gets the vertices of every frame, metres, y up; the
file beside it, live.blend, the scene.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np
import onnxruntime

# From Blender's axes, z up, to the file's, y up.
TURN = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


class Garment:
    """A mesh that follows an armature; one step of the network for each frame of the scene."""

    def __init__(self, session, about, armature):
        self.session, self.about, self.armature = session, about, armature
        # A scale of 0.01, say, or a turn of the axes is no joint's motion.
        self.placed = armature.matrix_world.to_3x3().inverted().to_4x4()
        missing = [j for j in about["joints"] if j not in armature.pose.bones]
        if missing:
            raise SystemExit(f"{armature.name} lacks the joints {', '.join(missing)}")
        inputs = session.get_inputs()
        self.feed = {i.name: np.zeros(i.shape, np.float32) for i in inputs}
        if "parameters" in self.feed:  # bending, density, time scale; may change in every frame
            self.feed["parameters"][:] = 0.5, 0.2, 1.0
        self.names = [o.name for o in session.get_outputs()]
        self.frame, self.vertices = None, None
        faces = about["faces"]
        self.mesh = bpy.data.meshes.new("garment")
        self.mesh.from_pydata(np.zeros((np.max(faces) + 1, 3)), [], faces)
        self.mesh.shade_smooth()
        bpy.context.collection.objects.link(bpy.data.objects.new("garment", self.mesh))

    def pose(self, graph):
        """Transforms (J, 3, 4) of the joints from rest to this frame's pose, y up."""
        armature, out = self.armature.evaluated_get(graph), []
        for name in self.about["joints"]:
            posed, rest = armature.pose.bones[name], self.armature.data.bones[name]
            m = armature.matrix_world @ posed.matrix @ rest.matrix_local.inverted()
            m = np.array(m @ self.placed)
            out.append(np.c_[TURN @ m[:3, :3] @ TURN.T, TURN @ m[:3, 3]])
        return np.stack(out)

    def step(self, scene, graph):
        """Handler of a changed frame: the frame after the last one goes on, any other begins."""
        if scene.frame_current == self.frame:
            return
        begins = self.frame is None or scene.frame_current != self.frame + 1
        self.frame, self.feed["reset"][:] = scene.frame_current, begins
        self.feed["pose"][:] = self.pose(graph)
        out = dict(zip(self.names, self.session.run(self.names, self.feed), strict=True))
        self.vertices = out.pop("vertices")
        self.feed |= {name.removesuffix("_out"): state for name, state in out.items()}
        self.mesh.vertices.foreach_set("co", (self.vertices @ TURN.astype(np.float32)).ravel())
        self.mesh.update()


def main(model, body, target):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    try:
        session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
        about = json.loads(session.get_modelmeta().custom_metadata_map["garmentnet"])
    except Exception as error:  # of classes of onnxruntime's own
        raise SystemExit(f"{model}: no garment that can be run: {error!r}") from None
    scene.render.fps = round(about["fps"])  # before the import, which turns seconds into frames
    bpy.ops.import_scene.gltf(filepath=body)
    armature = next(o for o in bpy.data.objects if o.type == "ARMATURE")
    for other in [o for o in bpy.data.objects if o.type == "MESH"]:
        bpy.data.objects.remove(other)  # what the .glb plays itself
    first, last = armature.animation_data.action.frame_range
    scene.frame_start, scene.frame_end = round(first), round(last)
    garment = Garment(session, about, armature)
    bpy.app.handlers.frame_change_post.append(garment.step)
    frames = []
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        frames.append(garment.vertices)
    np.savez(target, vertices=np.stack(frames), faces=about["faces"])
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(target).with_suffix(".blend").absolute()))
    print(f"{target}: {len(frames)} frames of {len(garment.mesh.vertices)} vertices")


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    main(*arguments)
