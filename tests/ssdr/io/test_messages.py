"""Errors about files are sentences about the file, not the end of another program's traceback."""

from __future__ import annotations

import json
import re

import pytest

import ssdr
from helpers.blender_scene import needs_blender

ASSET = {"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}]}
GLTF = {
    "no attributes": ({"meshes": [{"primitives": [{}]}]}, "it has no 'attributes'"),
    "no primitives": ({"meshes": [{}]}, "it has no 'primitives'"),
    "a number for a list": (
        {"meshes": [{"primitives": 3}]},
        "an entry holds another kind of value",
    ),
    "a text for nodes": (
        {"meshes": [{}], "nodes": [{"mesh": 0, "children": "ab"}]},
        "an entry holds another kind of value",
    ),
}
USD = {
    "cut off": ('def Xform "a" {', r"\(USD says: 2:16: Expected }"),
    "a wrong tuple": ('def Mesh "a" { point3f[] points = [(0,0)] }', "USD says: .*Tuple dim"),
    "a missing layer": ("( subLayers = [@./gone.usda@] )", "refers to gone.usda, which is missing"),
}
FOREIGN = re.compile(
    r"Traceback|at line \d+ in file|not iterable|subscriptable|pxrInternal|File \""
)


@pytest.mark.parametrize("case", GLTF)
def test_gltf(tmp_path, case):
    change, message = GLTF[case]
    (tmp_path / "a.gltf").write_text(json.dumps(ASSET | change))
    with pytest.raises(ssdr.FormatError, match=message) as caught:
        ssdr.load(tmp_path / "a.gltf")
    assert not FOREIGN.search(str(caught.value))


@pytest.mark.parametrize("case", USD)
def test_usd(tmp_path, case):
    pytest.importorskip("pxr")
    text, message = USD[case]
    (tmp_path / "a.usda").write_text(f"#usda 1.0\n{text}")
    with pytest.raises(ssdr.FormatError, match=message) as caught:
        ssdr.load(tmp_path / "a.usda")
    assert not FOREIGN.search(str(caught.value))


@pytest.mark.parametrize("referred", [False, True])
def test_what_is_no_usd(tmp_path, referred):
    pytest.importorskip("pxr")
    (tmp_path / "a.usd").write_text("hello\n")
    layer = "#usda 1.0\n( subLayers = [@./a.usd@] )"
    (tmp_path / "b.usda").write_text(layer)
    message = r"b\.usda: refers to a.usd, which is no USD file" if referred else "not a USD file"
    with pytest.raises(ssdr.FormatError, match=message):
        ssdr.load(tmp_path / ("b.usda" if referred else "a.usd"))


@needs_blender
@pytest.mark.slow
def test_blender(tmp_path):
    (tmp_path / "a.fbx").write_bytes(b"; FBX 7.4\n")
    said = r"a\.fbx: Blender says: ASCII FBX files are not supported"
    with pytest.raises(ssdr.FormatError, match=said) as caught:
        ssdr.load(tmp_path / "a.fbx")
    assert not FOREIGN.search(str(caught.value))
