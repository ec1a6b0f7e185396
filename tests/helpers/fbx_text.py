"""FBX files as text, so that tests need no other program: meshes, skins, shapes and curves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

_SECOND = 46186158000  # of FBX's unit of time


class FbxText:
    """Objects and connections of a file; each method adds one and returns its number."""

    def __init__(self, *, unit: float = 100.0, up: str = "y", fps_mode: int = 11) -> None:
        axes = {"y": (1, 1, 2, 1), "z": (2, 1, 1, -1)}[up]
        names = "UpAxis", "UpAxisSign", "FrontAxis", "FrontAxisSign"
        values = dict(zip(names, axes, strict=True)) | {"CoordAxis": 0, "CoordAxisSign": 1}
        rows = [f'P: "{k}", "int", "Integer", "",{v}' for k, v in values.items()]
        rows.append(f'P: "UnitScaleFactor", "double", "Number", "",{unit:.17g}')
        rows.append(f'P: "TimeMode", "enum", "", "",{fps_mode}')
        self._head = "GlobalSettings:  {\n" + self._properties(rows) + "}\n"
        self._objects: list[str] = []
        self._links: list[str] = []
        self._next = 1000

    @staticmethod
    def _properties(rows: list[str]) -> str:
        return "Properties70:  {\n" + "\n".join(rows) + "\n}\n"

    @staticmethod
    def _array(name: str, values: Any) -> str:
        flat = np.ravel(values)
        return f"{name}: *{flat.size} {{\na: {','.join(f'{v:.17g}' for v in flat)}\n}}\n"

    def _add(self, kind: str, name: str, sub: str, body: str, *above: Any) -> int:
        self._next += 1
        self._objects.append(f'{kind}: {self._next}, "{name}", "{sub}" {{\n{body}}}\n')
        for to in above:
            self.link(self._next, to)
        return self._next

    def link(self, child: int, parent: Any) -> None:
        """Connect an object to another, or to a property of another (number, name)."""
        number, name = parent if isinstance(parent, tuple) else (parent, None)
        tail = "" if name is None else f', "{name}"'
        self._links.append(f'C: "{"OO" if name is None else "OP"}",{child},{number}{tail}')

    def node(self, name: str, parent: int = 0, *, kind: str = "Mesh", **properties: Any) -> int:
        """A node; `properties` are ``t``, ``r`` and ``s`` (local), or named as in FBX."""
        named = {"t": "Lcl Translation", "r": "Lcl Rotation", "s": "Lcl Scaling"}
        rows = []
        for key, value in properties.items():
            numbers = ",".join(f"{v:.17g}" for v in np.ravel(value))
            rows.append(f'P: "{named.get(key, key)}", "{named.get(key, "int")}", "", "A",{numbers}')
        return self._add("Model", f"Model::{name}", kind, self._properties(rows), parent)

    def mesh(
        self,
        node: int,
        points: Any,
        polygons: Any,
        *,
        uv: Any = None,
        normals: Any = None,
        colors: Any = None,
    ) -> int:
        """A mesh; `uv`, `normals` and `colors` have a row for each corner."""
        ends = np.concatenate([[*row[:-1], -1 - row[-1]] for row in polygons])
        body = self._array("Vertices", points) + self._array("PolygonVertexIndex", ends)
        layers = {"UV": (uv, "UV"), "Normal": (normals, "Normals"), "Color": (colors, "Colors")}
        for name, (values, key) in layers.items():
            if values is not None:
                how = 'MappingInformationType: "ByPolygonVertex"\n'
                how += 'ReferenceInformationType: "Direct"\n'
                values = self._array(key, values)
                body += f'LayerElement{name}: 0 {{\nName: ""\n{how}{values}}}\n'
        named = [name for name, (values, _) in layers.items() if values is not None]
        rows = [f'LayerElement:  {{\nType: "LayerElement{n}"\nTypedIndex: 0\n}}\n' for n in named]
        body += "Layer: 0 {\n" + "".join(rows) + "}\n"
        return self._add("Geometry", "Geometry::", "Mesh", body, node)

    def skin(self, mesh: int, clusters: dict[int, tuple[Any, Any, Any]], place: Any = None) -> int:
        """A skin: vertices, weights and matrix in the bind pose of each joint's node."""
        skin = self._add("Deformer", "Deformer::", "Skin", "Version: 101\n", mesh)
        place = np.eye(4) if place is None else place
        for joint, (vertices, weights, bind) in clusters.items():
            body = self._array("Indexes", vertices) + self._array("Weights", weights)
            body += self._array("Transform", (np.linalg.inv(bind) @ place).T)
            body += self._array("TransformLink", np.asarray(bind).T)
            self.link(joint, self._add("Deformer", "SubDeformer::", "Cluster", body, skin))
        return skin

    def shapes(self, mesh: int, name: str, targets: dict[float, tuple[Any, Any]]) -> int:
        """A channel of shapes: vertices and displacements of the target at each percentage."""
        blend = self._add("Deformer", "Deformer::", "BlendShape", "Version: 100\n", mesh)
        body = self._array("FullWeights", list(targets))
        channel = self._add("Deformer", f"SubDeformer::{name}", "BlendShapeChannel", body, blend)
        for percent, (vertices, moved) in targets.items():
            body = self._array("Indexes", vertices) + self._array("Vertices", moved)
            self._add("Geometry", f"Geometry::{name}{percent:g}", "Shape", body, channel)
        return channel

    def lamp(self, parent: int) -> int:
        """A node with a light."""
        return self._add(
            "NodeAttribute", "NodeAttribute::", "Light", "", self.node("lamp", parent, kind="Light")
        )

    def material(self, node: int, name: str) -> int:
        return self._add("Material", f"Material::{name}", "", 'ShadingModel: "phong"\n', node)

    def cache(self, mesh: int, file: str, channel: str) -> None:
        rows = [
            f'P: "{k}", "KString", "Url", "","{file}"'
            for k in ("CacheFileName", "CacheAbsoluteFileName")
        ]
        held = self._add("Cache", "Cache::", "", self._properties(rows))
        rows = [f'P: "ChannelName", "KString", "", "","{channel}"']
        body = self._properties(rows)
        self.link(held, self._add("Deformer", "Deformer::", "VertexCacheDeformer", body, mesh))

    def stack(self, name: str, start: float, stop: float, *layers: dict[Any, Any]) -> int:
        """A stack of layers; each has keys [(time, value), ...] by (number, property, channel)."""
        rows = [f'P: "{k}", "KTime", "Time", "",{round(v * _SECOND)}'
                for k, v in (("LocalStart", start), ("LocalStop", stop))]  # fmt: skip
        stack = self._add("AnimationStack", f"AnimStack::{name}", "", self._properties(rows))
        for curves in layers:
            layer = self._add("AnimationLayer", "AnimLayer::layer", "", "", stack)
            held: dict[Any, int] = {}
            for (number, prop, channel), keys in curves.items():
                if (number, prop) not in held:
                    above = layer, (number, prop)
                    held[number, prop] = self._add(
                        "AnimationCurveNode", "AnimCurveNode::T", "", "", *above
                    )
                times, values = np.array(keys, dtype=float).T
                ticks = ",".join(str(round(t * _SECOND)) for t in times)
                body = f"KeyVer: 4008\nDefault: 0\nKeyTime: *{len(keys)} {{\na: {ticks}\n}}\n"
                body += self._array("KeyValueFloat", values) + self._array("KeyAttrFlags", [4])
                body += self._array("KeyAttrDataFloat", [0, 0, 0, 0])
                body += self._array("KeyAttrRefCount", [len(keys)])
                to = held[number, prop], f"d|{channel}"
                self._add("AnimationCurve", "AnimCurve::", "", body, to)
        return stack

    def text(self) -> str:
        head = (
            "; FBX 7.4.0 project file\nFBXHeaderExtension:  {\nFBXVersion: 7400\n}\n" + self._head
        )
        objects = "Objects:  {\n" + "".join(self._objects) + "}\n"
        return head + objects + "Connections:  {\n" + "\n".join(self._links) + "\n}\n"

    def save(self, path: Path) -> Path:
        path.write_text(self.text(), encoding="utf-8")
        return path
