#!/usr/bin/env bash
# The main job on the sample that ships with the package.  Run it through `make demo`.
set -euo pipefail
cd "$(dirname "$0")/.."
out=${OUT:-out}
mkdir -p "$out"
bin=${VENV:-.venv}/bin
sample=$("$bin/python" -c 'from ssdr import samples; print(samples.path("dancer"))')
"$bin/ssdr" decompose "$sample" --bones 24 --influences 4 \
    -o "$out/sample.glb" -o "$out/sample.npz" -o "$out/sample.png" -o "$out/sample.html"
printf '\nDone. In %s:\n' "$(cd "$out" && pwd)"
printf '  %-12s %s\n' sample.html "a double click shows model and input side by side" \
    sample.png "the picture: mesh by bone weights, bones, error" \
    sample.glb "the skinned, animated model; any glTF viewer or engine plays it" \
    sample.npz "rest pose, weights and transforms as NumPy arrays"
