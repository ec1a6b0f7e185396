#!/usr/bin/env bash
# Builds both distributions, installs their wheels into new environments where no compiler is to be
# found, and tries them.  Run it through `make release` (PYTHONS="python3.12 ..." for more of them).
# Environment: PYTHONS (interpreters to try, .venv's by default), GARMENTNET=0 (build garmentnet but
# do not install it: torch is large).
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
python=$root/.venv/bin/python
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
"$python" -m twine check --strict dist/*
"$python" .ci/check_wheels.py dist

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

for one in ${PYTHONS:-$python}; do
    env=$try/env
    rm -rf "$env"
    "$one" -m venv "$env"
    say "ssdr on $("$env/bin/python" -V), wheels alone"
    before=$(du -sm "$env" | cut -f1)
    without_compiler "$env" "$env/bin/python" -m pip install -q "$(ls dist/ssdr-*.whl)"
    "$env/bin/python" -m pip check
    say "installed size $(($(du -sm "$env" | cut -f1) - before)) MB, the largest parts:"
    du -sm "$env"/lib/python*/site-packages/* | sort -rn | head -n 8 | sed 's|\t.*/| MB  |; s/^/  /'
    (
        cd "$try/empty"
        rm -rf ./*
        export NUMBA_CACHE_DIR=$try/numba  # as on a new machine
        rm -rf "$NUMBA_CACHE_DIR"
        "$env/bin/python" "$root/.ci/check_install.py"
        without_compiler "$env" ssdr --version
        sample=$("$env/bin/python" -c 'import ssdr; print(ssdr.samples.path("dancer"))')
        without_compiler "$env" ssdr info "$sample" >/dev/null
        for round in first second; do
            start=$SECONDS
            without_compiler "$env" ssdr decompose "$sample" --bones 24 --influences 4 -q -o dance.glb
            say "decompose of the sample, $round run: $((SECONDS - start)) s"
        done
        without_compiler "$env" ssdr compare "$sample" dance.glb
    )
done

if [ "${GARMENTNET:-1}" != 0 ]; then
    say "garmentnet beside it"
    without_compiler "$env" "$env/bin/python" -m pip install -q -c .ci/constraints.txt dist/*.whl
    "$env/bin/python" -m pip check
    (cd "$try/empty" && without_compiler "$env" garmentnet --help >/dev/null)
fi
ls -l dist
say "all of it is well; docs/contributing.md has the steps that are left"
