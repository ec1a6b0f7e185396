"""What an engine draws of a file, read by code of its own: positions and turned normals.

Skinning here is that of three.js and of the glTF specification, section 3.7.3: the weighted sum of
the joints' matrices moves points, and turns the normals of the file.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from helpers import naive
from helpers.glb import opened, values_of
from helpers.stages import items


def vertex_normals(frames, faces, groups=None):
    """Angle-weighted normals (F, T, 3, 3) at corners, one for each of `groups` (T, 3)."""
    groups = faces if groups is None else groups
    out = []
    for points in np.asarray(frames, dtype=np.float64):
        p = points[faces]
        sides = [p[:, (c + 1) % 3] - p[:, c] for c in range(3)]
        normal = np.cross(sides[0], sides[1])
        with np.errstate(invalid="ignore"):
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        total = np.zeros((groups.max() + 1, 3))
        for c in range(3):
            angle = np.radians(180 - naive.angles(sides[c], sides[c - 1]))
            np.add.at(total, groups[:, c], np.nan_to_num(angle[:, None] * normal))
        with np.errstate(invalid="ignore"):
            out.append((total / np.linalg.norm(total, axis=1, keepdims=True))[groups])
    return np.array(out)


def groups_of(faces, hard=None):
    """Numbers (T, 3) of equal vertices at corners; with `hard`, of equal normals of these."""
    key = faces.reshape(-1, 1)
    if hard is not None:
        key = np.concatenate([key, hard.reshape(-1, 3)], axis=1)
    return np.unique(key, axis=0, return_inverse=True)[1].reshape(-1, 3)


def surface_normals(points, faces, hard=None):
    """Normals (T, 3, 3) by loops over triangles; corners with equal `hard` share one."""
    return naive.corner_normals(points, faces, groups_of(faces, hard))


def model_normals(model, frame):
    """Normals (T, 3, 3) of the rest pose, turned by Σ w R in loops over corners."""
    rest = None if model.surface is None else model.surface.normals
    rest = surface_normals(model.rest, model.faces) if rest is None else rest
    out = np.empty((len(model.faces), 3, 3))
    for t, c in np.ndindex(len(model.faces), 3):
        v = model.faces[t, c]
        turn = np.tensordot(model.weights[v], model.transforms[frame, model.indices[v], :, :3], 1)
        turned = turn.astype(np.float64) @ rest[t, c]
        out[t, c] = turned / np.linalg.norm(turned)
    return out


def mean_angle(a, b):
    """Mean angle in degrees, where both are known."""
    return float(np.nanmean(naive.angles(a, b)))


def from_gltf(path, *, clip=0, seconds=None):
    """Each skinned mesh of a ``.glb``: positions, normals (F, N, 3), faces and ``_VERTEX``.

    At the keys of a clip, which is a number or a name, or at times of it in seconds.
    """
    document, binary = opened(path)

    def read(number):
        values = values_of(document, binary, number).astype(np.float64)
        item = document["accessors"][number]
        if item.get("normalized"):
            values /= {5120: 127, 5121: 255, 5122: 32767, 5123: 65535}[item["componentType"]]
        return values

    nodes, keys = document["nodes"], {}
    clips = enumerate(document["animations"])
    animation = next(one for k, one in clips if clip in (k, one.get("name")))
    for channel in animation["channels"]:
        sampler, target = animation["samplers"][channel["sampler"]], channel["target"]
        times, values = read(sampler["input"])[:, 0], read(sampler["output"])
        keys[target["node"], target["path"]] = times, values.reshape(len(times), -1)
    if seconds is None:
        seconds = max((times for times, _ in keys.values()), key=len)
    count = len(seconds)
    parent = {child: k for k, node in enumerate(nodes) for child in node.get("children", [])}

    def track(node, path, default):
        if (node, path) not in keys:
            return np.tile(np.array(nodes[node].get(path, default), float), (count, 1))
        times, values = keys[node, path]
        at = np.clip(seconds, times[0], times[-1])
        if path == "rotation" and len(times) > 1:
            return Slerp(times, Rotation.from_quat(values))(at).as_quat()
        return np.stack([np.interp(at, times, column) for column in values.T], axis=1)

    def world(node):
        found = np.tile(np.eye(4), (count, 1, 1))
        turn = Rotation.from_quat(track(node, "rotation", [0, 0, 0, 1])).as_matrix()
        found[:, :3, :3] = turn * track(node, "scale", [1, 1, 1])[:, None]
        found[:, :3, 3] = track(node, "translation", [0, 0, 0])
        assert "matrix" not in nodes[node]
        return world(parent[node]) @ found if node in parent else found

    amounts = next((track(*key, None) for key in keys if key[1] == "weights"), None)
    result = []
    for node in nodes:
        if "mesh" not in node or "skin" not in node:
            continue
        skin = document["skins"][node["skin"]]
        binds = read(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
        moves = np.stack([world(k) for k in skin["joints"]], axis=1) @ binds
        primitives = document["meshes"][node["mesh"]]["primitives"]
        attributes = primitives[0]["attributes"]
        assert all(one["attributes"] == attributes for one in primitives)
        faces = np.concatenate([read(one["indices"]).astype(int) for one in primitives])
        sets = [k for k in (0, 1) if f"JOINTS_{k}" in attributes]
        joints, weights = (
            np.concatenate([read(attributes[f"{name}_{k}"]) for k in sets], axis=1)
            for name in ("JOINTS", "WEIGHTS")
        )
        joints = joints.astype(int)
        blended = np.zeros((count, len(joints), 4, 4))
        for k in range(joints.shape[1]):
            blended += weights[:, k, None, None] * moves[:, joints[:, k]]
        points, normals = (
            np.tile(read(attributes[name]), (count, 1, 1)) for name in ("POSITION", "NORMAL")
        )
        if amounts is not None:
            targets = primitives[0]["targets"]
            for target, factor in zip(targets, amounts.T, strict=True):
                points += factor[:, None, None] * read(target["POSITION"])
                normals += factor[:, None, None] * read(target["NORMAL"])
        positions = np.einsum("fnij,fnj->fni", blended[:, :, :3, :3], points)
        positions += blended[:, :, :3, 3]
        normals = np.einsum("fnij,fnj->fni", blended[:, :, :3, :3], normals)
        vertex = read(attributes["_VERTEX"])[:, 0].astype(int) if "_VERTEX" in attributes else None
        result.append((positions, normals, faces.reshape(-1, 3), vertex))
    return result


def from_usd(path, codes):
    """Turned normals (F, T, 3, 3) at the corners of the only mesh of a USD file of triangles."""
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.Open(str(path))
    (mesh,), (skeleton,) = items(stage, UsdGeom.Mesh), items(stage, UsdSkel.Skeleton)
    cache = UsdSkel.Cache()
    cache.Populate(UsdSkel.Root.Find(mesh.GetPrim()), Usd.PrimDefaultPredicate)
    skin, query = cache.GetSkinningQuery(mesh.GetPrim()), cache.GetSkelQuery(skeleton)
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if primvar:
        normals = np.array(primvar.ComputeFlattened(), dtype=float).reshape(-1, 3, 3)
    else:
        assert mesh.GetNormalsInterpolation() == "vertex"
        normals = np.array(mesh.GetNormalsAttr().Get(), dtype=float)[faces]
    bind = np.array(skin.GetGeomBindTransform())[:3, :3]  # of row vectors
    normals = normals @ np.linalg.inv(bind).T
    joints, weights = (
        np.array(x).reshape(faces.max() + 1, -1)
        for x in skin.ComputeVaryingJointInfluences(int(faces.max()) + 1)
    )
    out = []
    for code in codes:
        moves = np.array(query.ComputeSkinningTransforms(code))[:, :3, :3].swapaxes(1, 2)
        blended = np.einsum("nk,nkij->nij", weights, moves[joints])
        out.append(np.einsum("tcij,tcj->tci", blended[faces], normals))
    return np.array(out)
