"""Run by a Python with bpy: render one frame of files beside each other, by Cycles on the CPU.

    python benchmarks/interchange/blender_picture.py out.png FRAME file.glb|file.usdc|frame.obj ...

Each file is imported by Blender's own importer; the materials are those of the file.  `--bones`
draws Blender's bones, from head to tail, inside meshes that one sees through.
"""

import argparse
import math

import numpy as np

try:
    import bpy
    from mathutils import Matrix, Vector
except ModuleNotFoundError:  # --help works anywhere
    bpy = None


def load(path):
    before = set(bpy.context.scene.objects)
    if path.endswith((".glb", ".gltf")):
        bpy.ops.import_scene.gltf(filepath=path)
    elif path.endswith(".fbx"):
        bpy.ops.import_scene.fbx(filepath=path, anim_offset=0.0)
    elif path.endswith(".obj"):
        bpy.ops.wm.obj_import(filepath=path)
    else:
        bpy.ops.wm.usd_import(filepath=path)
    return [o for o in bpy.context.scene.objects if o not in before]


def bounds(items):
    graph = bpy.context.evaluated_depsgraph_get()
    points = []
    for item in items:
        if item.type == "MESH" and not item.name.startswith("Icosphere"):
            shown = item.evaluated_get(graph)
            mesh = shown.to_mesh()
            matrix = np.array(shown.matrix_world)
            local = np.array([v.co for v in mesh.vertices])
            points.append(local @ matrix[:3, :3].T + matrix[:3, 3])
            shown.to_mesh_clear()
    points = np.concatenate(points)
    return points.min(axis=0), points.max(axis=0)


def material(name, color, alpha):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Alpha"].default_value = alpha
    return made


def draw_bones(item):
    """Octahedra from the heads to the tails of an armature's bones, as they are posed."""
    points, faces = [], []
    for bone in item.pose.bones:
        head, tail = (item.matrix_world @ p for p in (bone.head, bone.tail))
        way = tail - head
        one = way.orthogonal().normalized() * 0.09 * way.length
        two = way.cross(one).normalized() * one.length
        waist, k = head + 0.16 * way, len(points)
        points += [head, *(waist + side for side in (one, two, -one, -two)), tail]
        for j in range(4):
            a, b = k + 1 + j, k + 1 + (j + 1) % 4
            faces += [(k, b, a), (k + 5, a, b)]
    mesh = bpy.data.meshes.new("bones")
    mesh.from_pydata([tuple(p) for p in points], [], faces)
    mesh.materials.append(material("bone", (0.85, 0.25, 0.1), 1.0))
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("bones", mesh))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("out")
    parser.add_argument("frame", type=int)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--turn", type=float, default=0.0, help="degrees about the vertical")
    parser.add_argument("--bones", action="store_true", help="draw bones inside the meshes")
    args = parser.parse_args()
    if bpy is None:
        parser.error("this Python has no bpy")
    out, frame, files = args.out, args.frame, args.files
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = 24
    groups = [load(path) for path in files]
    scene.frame_set(frame)
    low, high = bounds(groups[0])
    if args.turn:  # whatever its angle, a model keeps to its own place
        half = float(np.linalg.norm((high - low)[:2])) / 2
        centre = (low + high) / 2
        low[:2], high[:2] = centre[:2] - half, centre[:2] + half
    width = 1.2 * max(high[0] - low[0], 0.5 * (high[2] - low[2]))
    for k, items in enumerate(groups):
        # A parent, as the location of an imported object may be animated.
        holder = bpy.data.objects.new(f"place_{k}", None)
        turn = Matrix.Rotation(math.radians(args.turn), 4, "Z")
        about = Vector((*((low + high)[:2] / 2), 0))
        move = Matrix.Translation(Vector((k * width, 0, 0)) + about)
        holder.matrix_world = move @ turn @ Matrix.Translation(-about)
        scene.collection.objects.link(holder)
        for item in items:
            if item.parent is None:
                item.parent = holder
            if item.type == "ARMATURE" or item.name.startswith("Icosphere"):
                item.hide_render = True
    if args.bones:
        bpy.context.view_layer.update()
        glass = material("glass", (0.8, 0.8, 0.8), 0.25)
        for item in [item for items in groups for item in items]:
            if item.type == "ARMATURE":
                draw_bones(item)
            elif item.type == "MESH":
                item.data.materials.clear()
                item.data.materials.append(glass)
    center = Vector(
        (
            (low[0] + high[0] + (len(groups) - 1) * width) / 2,
            (low[1] + high[1]) / 2,
            (low[2] + high[2]) / 2,
        )
    )
    tall = float(high[2] - low[2]) * 1.1
    wide = width * len(groups)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = max(wide, tall)
    camera.location = center + Vector((0, -50 * tall, 0))
    camera.data.clip_end = 1000 * tall
    camera.rotation_euler = (math.pi / 2, 0, 0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy = 2
    sun.rotation_euler = (0.8, 0.2, 0.5)
    scene.collection.objects.link(sun)
    world = bpy.data.worlds.new("world")
    scene.world = world
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (0.35, 0.35, 0.38, 1)
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 16
    scene.cycles.use_denoising = False
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x = 1200
    scene.render.resolution_y = round(1200 * tall / max(wide, tall))
    scene.render.filepath = out
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
