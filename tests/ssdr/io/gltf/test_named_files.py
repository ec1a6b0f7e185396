"""Files that a glTF file names are files of its folder."""

from __future__ import annotations

import json
import os

import pytest

import ssdr
from helpers.gltf_asset import make_asset

IMAGES = {
    "a\0b.png": "is missing",
    "a" * 100_000: "is missing",
    "../p.png": "lies outside",
    "pipe.png": "is missing",
    "endless.png": "lies outside",
    "http://x/p.png": "lies outside",
    7: "is missing",
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders here")
@pytest.mark.parametrize("uri", IMAGES, ids=[str(uri)[:12].replace("\0", "0") for uri in IMAGES])
@pytest.mark.parametrize("what", ["images", "buffers"])
def test_files_that_a_file_names_are_files_of_its_folder(tmp_path, uri, what):
    source = make_asset(tmp_path / "all.gltf")
    model = ssdr.load_skinning(source).skinning
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "endless.png").symlink_to("/dev/zero")
    document = json.loads(source.read_text())
    document[what][0]["uri"] = uri
    source.write_text(json.dumps(document))
    for target in ("b.glb", "b.gltf"):
        with pytest.raises(ssdr.FormatError, match=r"all\.gltf: .*" + IMAGES[uri] + "|no text"):
            ssdr.save(model, tmp_path / target, template=source)
    with pytest.raises(ssdr.FormatError, match=r"all\.gltf"):
        ssdr.load(source)
