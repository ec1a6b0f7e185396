"""Program that runs the function `read` of a script: ``python reading_process.py job.json``.

It needs only NumPy and what the script needs, not the package. It limits the memory of its process
to that of the job, and writes what `read` returns for the job to an archive: a record, as the bytes
of its JSON, and arrays; or the reason why the file is not read: an error called Refused, or an
error of the library.
"""

import contextlib
import json
import os
import runpy
import sys

import numpy as np

_SPARE = 2 << 30  # bytes of address space beside the arrays: the library and NumPy


def main() -> None:
    with open(sys.argv[1], encoding="utf-8") as stream:
        job = json.load(stream)
    with contextlib.suppress(ImportError, ValueError, OSError):  # Windows has none
        import resource

        most = 3 * int(job["max_bytes"]) + _SPARE
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    read = runpy.run_path(job["script"])["read"]
    try:
        found, arrays = read(job)
        arrays["found"] = np.frombuffer(json.dumps(found).encode(), dtype=np.uint8)
    except Exception as error:
        said = (str(error).strip().splitlines() or [type(error).__name__])[-1]
        if type(error).__name__ != "Refused":
            if not isinstance(error, RuntimeError):
                raise
            said = f"truncated or damaged; {job['who']} says: {said}"
        arrays = {"error": np.array(said)}
    np.savez(job["out"], **arrays)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # a library may crash at the interpreter's end


if __name__ == "__main__":
    main()
