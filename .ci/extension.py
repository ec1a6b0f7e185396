"""Build the Blender extension by Blender's own tool: ``python .ci/extension.py OUTPUT_FOLDER``."""

import runpy
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "ssdr" / "cli" / "blender"


def build(folder: str) -> None:
    """Inside Blender: run the tool that its command `extension build` runs."""
    import bpy

    scripts = Path(bpy.utils.system_resource("SCRIPTS"))
    tool = scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    sys.argv = [str(tool), "build", "--source-dir", str(SOURCE), "--output-dir", folder]
    runpy.run_path(str(tool), run_name="__main__")


def main() -> None:
    sys.path.insert(0, str(ROOT))
    from ssdr.common.errors import SsdrError
    from ssdr.io.blender.finder import command

    folder = Path(sys.argv[1]).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        words = command(Path(__file__).resolve(), "inside", str(folder))
    except SsdrError as error:
        sys.exit(f"{error}\nThe extension is built by Blender's own tool and needs it, too.")
    sys.exit(subprocess.run(words, check=False).returncode)


if __name__ == "__main__":
    if "inside" in sys.argv:
        build(sys.argv[-1])
    else:
        main()
