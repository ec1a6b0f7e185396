#!/usr/bin/env bash
# Builds both distributions, installs their wheels into new environments where no compiler is to be
# found, and tries them.  Run it through `make release` (PYTHONS="python3.12 ..." for more of them).
# Environment: PYTHONS (interpreters to try, .venv's by default), GARMENTNET=0 (build garmentnet but
# do not install it: torch is large).
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
python=$(cd "${VENV:-.venv}" && pwd)/bin/python
say() { printf 'release: %s\n' "$*"; }

# From a copy: what earlier builds and runs left beside the sources must not get into a wheel.
try=$(mktemp -d)
trap 'rm -rf "$try"' EXIT
mkdir "$try/tree" "$try/empty"
tar -c --exclude=__pycache__ --exclude=build --exclude='*.egg-info' --exclude='*.nbi' --exclude='*.nbc' \
    pyproject.toml README.md LICENSE CHANGELOG.md CITATION.cff ssdr garmentnet | tar -x -C "$try/tree"
rm -rf dist
say "building"
"$python" -m build -q -o dist "$try/tree"
"$python" -m build -q -o dist "$try/tree/garmentnet"

# No compiler by any name: what needs one fails here and not at a user's.
without_compiler() {
    local folder clean= IFS=:
    for folder in $PATH; do
        if ! compgen -G "$folder/*cc" >/dev/null && ! compgen -G "$folder/[cg]++*" >/dev/null \
            && ! compgen -G "$folder/clang*" >/dev/null; then
            clean="$clean:$folder"
        fi
    done
    env PATH="$1/bin$clean" CC=/bin/false CXX=/bin/false FC=/bin/false \
        PIP_ONLY_BINARY=:all: PIP_DISABLE_PIP_VERSION_CHECK=1 "${@:2}"
}

# Times calls, and compares what they write with what the first of all wrote.
decompose_sample() {
    local round start
    for round in "$@"; do
        start=$SECONDS
        without_compiler "$env" ssdr decompose "$sample" --bones 24 --influences 4 -q -o "$round.glb"
        say "decompose of the sample, $round: $((SECONDS - start)) s"
        cmp compiled.glb "$round.glb"  # the same bits from machine code of every origin
    done
}

for one in ${PYTHONS:-$python}; do
    env=$try/env
    rm -rf "$env" "$try/empty"/* "$try/numba"
    "$one" -m venv "$env"
    say "ssdr on $("$env/bin/python" -V), wheels alone"
    before=$(du -sm "$env" | cut -f1)
    without_compiler "$env" "$env/bin/python" -m pip install -q "$(ls dist/ssdr-*-none-any.whl)"
    "$env/bin/python" -m pip check
    say "installed size $(($(du -sm "$env" | cut -f1) - before)) MB, the largest parts:"
    du -sm "$env"/lib/python*/site-packages/* | sort -rn | head -n 8 | sed 's|\t.*/| MB  |; s/^/  /'
    export NUMBA_CACHE_DIR=$try/numba  # as on a new machine
    cd "$try/empty"
    "$env/bin/python" "$root/.ci/check_install.py"
    without_compiler "$env" ssdr --version
    sample=$("$env/bin/python" -c 'import ssdr; print(ssdr.samples.path("dancer"))')
    without_compiler "$env" ssdr info "$sample" >/dev/null
    decompose_sample compiled cached
    without_compiler "$env" ssdr compare "$sample" compiled.glb
    cd "$root"

    say "the wheel with machine code"
    "$env/bin/python" -m pip install -q setuptools  # asked for by Numba's pycc
    platform=$("$env/bin/python" .ci/kernels.py "$try/tree")
    "$env/bin/python" -m pip uninstall -q -y setuptools
    tag=$("$env/bin/python" -c 'import sys; print("cp%d%d" % sys.version_info[:2])')
    "$python" -m build -q -w -C--build-option="--plat-name $platform --python-tag $tag" -o dist "$try/tree"
    rm -r "$try"/tree/ssdr/kernels/{avx2,baseline}_* "$try/tree/build"
    without_compiler "$env" "$env/bin/python" -m pip install -q --no-deps --force-reinstall \
        "$(ls dist/ssdr-*-"$tag"-*.whl)"
    rm -rf "$try/numba"
    cd "$try/empty"
    decompose_sample shipped
    without_compiler "$env" ssdr compare "$sample" shipped.glb >/dev/null
    rm -f "$env"/lib/python*/site-packages/ssdr/kernels/avx2_*
    decompose_sample baseline
    [ ! -e "$try/numba" ] || { say "something was left to compile"; exit 1; }
    cd "$root"
done
"$python" -m twine check --strict dist/*
"$python" .ci/check_wheels.py dist

if [ "${GARMENTNET:-1}" != 0 ]; then
    say "garmentnet beside it"
    without_compiler "$env" "$env/bin/python" -m pip install -q -c .ci/constraints.txt dist/garmentnet-*.whl
    "$env/bin/python" -m pip check
    (cd "$try/empty" && without_compiler "$env" garmentnet --help >/dev/null)
fi
ls -l dist
say "all of it is well; docs/contributing.md has the steps that are left"
