"""Layers that a stage opens: of its folder, files, and nested no deeper than usd-core holds."""

from __future__ import annotations

import os
import zipfile

import pytest

import ssdr
from helpers.rig_model import tube

pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
from pxr import Sdf

CLIPS = 'clips = {{\n dictionary default = {{\n {}\n string primPath = "/a"\n }}\n }}'
OUTSIDE = {
    "reference": "references = @../out.usda@",
    "payload": "payload = @../out.usda@",
    "with arguments": "references = @../out.usda:SDF_FORMAT_ARGS:a=b@",
    "in a package": "references = @../out.usdz[a.usda]@",
    "value clips": CLIPS.format("asset[] assetPaths = [@./in.usda@, @../out.usda@]"),
    "a pattern of value clips": CLIPS.format('string templateAssetPath = "../out.###.usda"'),
    "a manifest": CLIPS.format("asset manifestAssetPath = @../out.usda@"),
    "a link": "references = @./link.usda@",
    "a sublayer": "references = @./sublayer.usda@",
    "a far reference": "references = @./far.usda@",
    "an endless device": "references = @./zero.usda@",
}
UNREADABLE = {
    "a pipe": ("payload = @./pipe.usda@", "a device, a pipe or a socket"),
    "a pipe among value clips": (
        CLIPS.format('string templateAssetPath = "./pipe.##.usda"'),
        "a device, a pipe or a socket",
    ),
    "a package": ("references = @./packed.usdz@", "packed.usdz is a package"),
    "a deep layer": ("references = @./deep.usda@", "deep.usda is nested 2000 deep"),
    "a deep value clip": (
        CLIPS.format("asset[] assetPaths = [@./deep.usda@]"),
        "deep.usda is nested 2000 deep",
    ),
}
INNER = '#usda 1.0\ndef Xform "a" {\n}\n'


@pytest.fixture
def stage(tmp_path):
    """A function that writes a stage in a folder of traps, one prim with the given metadata."""
    inner = tmp_path / "model"
    inner.mkdir()
    ssdr.save(tube(frames=2, rings=3, sides=3), inner / "a.usda")
    (tmp_path / "out.usda").write_text(INNER)
    (inner / "in.usda").write_text(INNER)
    (inner / "parts").mkdir()
    (inner / "parts" / "in.usda").write_text(INNER)
    (inner / "sublayer.usda").write_text("#usda 1.0\n(\n subLayers = [@../out.usda@]\n)\n")
    (inner / "far.usda").write_text(INNER.replace('"a"', '"a" (payload = @../out.usda@)'))
    (inner / "deep.usda").write_text("#usda 1.0\n" + 'def "a" {\n' * 2000 + "}\n" * 2000)
    (inner / "link.usda").symlink_to(tmp_path / "out.usda")
    (inner / "zero.usda").symlink_to("/dev/zero")
    with zipfile.ZipFile(inner / "packed.usdz", "w") as package:
        package.writestr("a.usda", INNER)

    def write(metadata):
        with (inner / "a.usda").open("a") as stream:
            stream.write(f'def "more" (\n{metadata}\n) {{}}\n')
        return inner / "a.usda"

    return write


@pytest.mark.parametrize("case", OUTSIDE)
def test_layers_outside_the_folder_are_refused(stage, case):
    path = stage(OUTSIDE[case])
    for read in (ssdr.load, ssdr.list_clips):
        with pytest.raises(ssdr.FormatError, match="lies outside its folder"):
            read(path)


READ = ("reference", "payload", "with arguments", "value clips", "a link", "a far reference")


@pytest.mark.parametrize("case", READ)
def test_layers_of_a_folder_that_the_user_names_are_read(stage, case, tmp_path):
    path = stage(OUTSIDE[case])
    for folder in (tmp_path, str(tmp_path)):
        assert ssdr.load(path, folder=folder).n_vertices == 11
    assert len(ssdr.list_clips(path, folder=tmp_path)) == 1
    assert ssdr.io.list_meshes(path, folder=tmp_path) == ("Mesh",)
    assert ssdr.load_skinning(path, folder=tmp_path).n_vertices == 11
    with pytest.raises(ssdr.FormatError, match="folder= names"):
        ssdr.load(path)  # the permission was for one call
    for wrong in (path, "none", 3):
        with pytest.raises(ssdr.InputError, match="folder: expected a folder that exists"):
            ssdr.load(path, folder=wrong)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders here")
@pytest.mark.parametrize("case", UNREADABLE)
def test_layers_that_are_no_files_or_too_deep_are_refused(stage, case):
    metadata, message = UNREADABLE[case]
    path = stage(metadata)
    for name in ("pipe.usda", "pipe.01.usda"):
        os.mkfifo(path.with_name(name))
    with pytest.raises(ssdr.FormatError, match=message):
        ssdr.load(path)


@pytest.mark.parametrize(
    "metadata",
    [
        "references = @./in.usda@",
        "references = @./parts/in.usda@",
        CLIPS.format("asset[] assetPaths = [@./in.usda@]"),
        CLIPS.format(
            'string templateAssetPath = "./in.#.usda"\n double templateStartTime = 0\n'
            " double templateEndTime = 9600\n double templateStride = 1"
        ),
        "active = true",
        "customData = { asset a = @../picture.png@ }",
    ],
)
def test_layers_of_the_folder_are_read(stage, metadata):
    assert ssdr.load(stage(metadata)).n_vertices == 11


@pytest.mark.parametrize(
    ("end", "stride", "other"),
    [(1e9, 0.001, ""), ("inf", 1, ""), (1, 1, "double templateStride = 1e-9"), (1e9, None, None)],
)
@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_value_clips_without_end_are_refused(tmp_path, end, stride, other, suffix):
    """USD looks for each of the files, and answers no signal meanwhile."""
    times = f"double templateStartTime = 0\n double templateEndTime = {end}\n"
    times += f"double templateStride = {stride or 1}\n" if other is not None else ""
    clips = CLIPS.format(f'string templateAssetPath = "./clip.#.#.usda"\n{times}')
    weaker = tmp_path / f"weaker{suffix}"
    text = f'#usda 1.0\ndef Mesh "M" (\n{clips}\n) {{}}\n'
    layer = Sdf.Layer.CreateNew(str(weaker))
    layer.ImportFromString(text)
    layer.Save()
    own = CLIPS.format("double templateStride = 0.001" if other is None else other)
    path = tmp_path / "a.usda"
    path.write_text(
        f"#usda 1.0\n(\n subLayers = [@./{weaker.name}@]\n)\n"
        f'over "M" (\n variants = {{ string v = "a" }}\n prepend variantSets = "v"\n) {{\n'
        f'variantSet "v" = {{ "a" (\n{own}\n) {{}} }}\n}}\n'
    )
    with pytest.raises(ssdr.FormatError, match=r"value clips of \S+ files, at most 100000"):
        ssdr.load(path)


def test_brackets_in_text_count_for_nothing(tmp_path):
    path = tmp_path / "a.usda"
    ssdr.save(tube(frames=2), path)
    hidden = 'def "more" { string s = "' + "(" * 2000 + '" # ' + "{" * 2000 + "\n}\n"
    path.write_text(path.read_text() + hidden)
    assert ssdr.load(path).n_vertices == 254
