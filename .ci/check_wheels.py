"""What is in the archives of dist/: the packages, nothing else, and nothing large."""

from __future__ import annotations

import re
import sys
import tarfile
import zipfile
from pathlib import Path

LIMIT = 5_000_000  # bytes of a wheel; the samples are 2.3 MB of one, a model 4.3 MB of the other
UNWANTED = re.compile(
    r"(^|/)(tests|benchmarks|docs|shared|out|build)/|\.(pyc|nbi|nbc|egg-info)$"
    r"|^(?!ssdr/kernels/).*\.(so|pyd)$"
)


def check(path: Path, names: list[str], tops: set[str]) -> None:
    wrong = [name for name in names if name.split("/")[0] not in tops or UNWANTED.search(name)]
    if wrong:
        raise SystemExit(f"{path.name} holds {', '.join(wrong[:5])}")
    if path.stat().st_size > LIMIT:
        raise SystemExit(f"{path.name} has {path.stat().st_size} bytes, more than {LIMIT}")
    print(f"{path.name}: {len(names)} files, {path.stat().st_size / 1e6:.2f} MB")


def main() -> None:
    folder = Path(sys.argv[1])
    wheels = sorted(folder.glob("*.whl"))
    pure = [path.name.partition("-")[0] for path in wheels if path.stem.endswith("-none-any")]
    if pure != ["garmentnet", "ssdr"]:
        raise SystemExit(f"{folder} holds {[path.name for path in wheels]}, not one wheel of each")
    for path in wheels:
        name, version = path.name.split("-")[:2]
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            check(path, names, {name, f"{name}-{version}.dist-info"})
            code = [held for held in names if held.endswith((".so", ".pyd"))]
            if bool(code) == path.stem.endswith("-none-any"):
                raise SystemExit(f"{path.name} holds {code} of machine code")
        source = folder / f"{name}-{version}.tar.gz"
        with tarfile.open(source) as archive:
            names = [m.name.partition("/")[2] for m in archive.getmembers() if m.isfile()]
            unwanted = [n for n in names if re.match(r"(tests|benchmarks|docs|shared)/", n)]
            if unwanted:
                raise SystemExit(f"{source.name} holds {', '.join(unwanted[:5])}")


if __name__ == "__main__":
    main()
