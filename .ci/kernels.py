"""Compile ssdr's kernels to machine code for a wheel of this platform and this Python.

    python .ci/kernels.py FOLDER_OF_SSDR

The only step of a release that needs a C compiler, for the frame around LLVM's code.  Kernels are
compiled for the types with which a few calls use them: other types are left to Numba.  Prints the
platform tag that the wheel needs.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import warnings
from pathlib import Path
from typing import Any


def use_kernels() -> None:
    """Run what users run, so that Numba sees the types of all arguments."""
    import numpy as np

    import ssdr
    from ssdr.show.figures import contact_sheet

    small = ssdr.samples.load("dancer_small")
    few = ssdr.MeshSequence(small.vertices[::4].astype(np.float64), small.faces)
    for rig in (None, "rigid"):
        model = ssdr.decompose(few, bones=5, effort="fast", rig=rig).skinning
    ssdr.decompose(few, bones=5, effort="fast", bone_model="similarity")
    ssdr.metrics.compare(small, ssdr.decompose(small, bones=5, effort="fast").skinning)
    contact_sheet(model, reference=few)
    for kind in (np.float32, np.float64):
        parts = (model.rest, model.indices, model.weights, model.transforms)
        gradient = np.ones_like(ssdr.skin(*parts, dtype=kind))
        ssdr.skin_gradients(*parts, gradient, dtype=kind)


def compile_level(file: Path) -> None:
    """Write the machine code of one level, for which the environment has set Numba up."""
    warnings.simplefilter("ignore")  # pycc may go one day; then a release needs another frame
    from numba import config, types
    from numba.core import codegen
    from numba.core.compiler import Flags
    from numba.pycc import CC
    from numba.pycc import compiler as pycc

    def flags() -> Any:
        made = Flags()
        made.release_gil, made.error_model = True, "numpy"  # as of policy.kernel
        return made

    pycc.Flags = flags
    codegen.AOTCPUCodegen._customize_tm_features = lambda self: config.CPU_FEATURES
    use_kernels()
    unit = CC(file.name.partition(".")[0])
    unit.target_cpu, unit.output_dir, unit.output_file = config.CPU_NAME, file.parent, file.name
    kinds = {types.boolean, types.int64, types.float64}
    for name, module in sorted(sys.modules.items()):
        for value in vars(module).values() if name.startswith("ssdr.kernels.") else ():
            options = getattr(value, "targetoptions", {"no_cpython_wrapper": True})
            if "no_cpython_wrapper" in options or value.__module__ != name:
                continue  # no kernel, or one of another module
            for arguments, compiled in value.overloads.items():
                words = [f"{name}.{value.__qualname__}"]
                for kind in arguments:
                    array = isinstance(kind, types.Array) and kind.layout == "C"
                    if not array and kind not in kinds:
                        raise SystemExit(f"{words[0]} takes {kind}")
                    words.append(f"{_char(kind.dtype)}{kind.ndim}" if array else "-")
                unit.export(" ".join(words), compiled.signature)(value.py_func)
    unit.compile()


def _char(kind: Any) -> str:
    from numba.np.numpy_support import as_dtype

    return str(as_dtype(kind).char)


def main(folder: Path, level: str = "", out: str = "") -> None:
    sys.path.insert(0, str(folder))
    from ssdr.kernels import policy

    if level:
        compile_level(Path(out, policy.code_file(level).name))
        return
    tag = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    needed = [0]
    # Beside the sources, the code of one level would serve the next.
    with tempfile.TemporaryDirectory() as made:
        for level, features in policy.LEVELS.items():
            generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": features}
            # without debugging information, and without what no kernel needs of Numba's frame
            small = {"CFLAGS": "-g0 -ffunction-sections", "LDFLAGS": "-s -Wl,--gc-sections"}
            cache = {"NUMBA_CACHE_DIR": f"{made}/cache_{level}"}
            subprocess.run(
                [sys.executable, __file__, str(folder), level, made],
                env={**os.environ, **generic, **small, **cache},
                check=True,
            )
        for level in policy.LEVELS:
            file = policy.code_file(level)
            shutil.copy(Path(made, file.name), file)
            needed += map(int, re.findall(rb"GLIBC_2\.(\d+)", file.read_bytes()))
    print(tag.replace("linux", f"manylinux_2_{max(needed)}") if max(needed) else tag)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), *sys.argv[2:])
