"""A stored glTF file that has everything: several meshes, morphs, clips, pictures, extras."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

ASSET = Path(__file__).parent / "asset"


def make_asset(path):
    """Write the file with what lies beside it; meshes Body and Coat are there to be replaced."""
    document = json.loads((ASSET / "asset.gltf").read_text())
    document["buffers"][0]["uri"] = f"{path.stem}-data.bin"
    shutil.copy(ASSET / "asset-data.bin", path.with_name(f"{path.stem}-data.bin"))
    shutil.copytree(ASSET / "maps", path.parent / "maps", dirs_exist_ok=True)
    path.write_text(json.dumps(document))
    return path
