#!/usr/bin/env bash
# Sets up everything that the Makefile's targets need, in $VENV or .venv beside this folder.
# Usage: .ci/setup.sh
# Environment: PYTHON (interpreter to build on), SSDR_NO_SYSTEM=1 (install no system package),
# EXTRAS (more of pyproject's extras, such as dask,docs; garmentnet is the second distribution,
# scenes what makes bodies beside it: tests of what is not installed skip).
set -euo pipefail
cd "$(dirname "$0")/.."

venv=${VENV:-.venv}
say() { printf 'setup: %s\n' "$*"; }
die() { printf 'setup: %s\n' "$*" >&2; exit 1; }

as_root=()
can_install() {
    [ -z "${SSDR_NO_SYSTEM:-}" ] && command -v apt-get >/dev/null || return 1
    if [ "$(id -u)" = 0 ]; then as_root=(); return 0; fi
    if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then as_root=(sudo -n); return 0; fi
    return 1
}

updated=
install_system() {
    can_install || return 1
    if [ -z "$updated" ]; then
        "${as_root[@]}" apt-get update -q >/dev/null 2>&1 || say "apt-get update failed, going on with the lists at hand"
        updated=1
    fi
    say "installing the system package(s) $*"
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -q --no-install-recommends "$@" >/dev/null 2>&1
}

usable() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }

find_python() {
    local candidate
    if [ -n "${PYTHON:-}" ]; then
        usable "$PYTHON" || die "PYTHON=$PYTHON is not a Python of version 3.11 or newer"
        printf '%s' "$PYTHON"
        return
    fi
    for candidate in python3.13 python3.12 python3.11 python3 python; do
        if command -v "$candidate" >/dev/null && usable "$candidate"; then
            command -v "$candidate"
            return
        fi
    done
    die "no Python of version 3.11 or newer on PATH; install one, or name it: make ... PYTHON=/path/to/python3"
}

make_venv() {
    local version
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    if "$python" -c 'import ensurepip, venv' 2>/dev/null; then
        "$python" -m venv --clear "$venv" && return
    fi
    # Debian ships Python without ensurepip.
    if install_system "python$version-venv" && "$python" -m venv --clear "$venv"; then
        return
    fi
    if "$python" -m virtualenv --version >/dev/null 2>&1; then
        "$python" -m virtualenv -q --clear "$venv" && return
    fi
    if "$python" -c 'import venv' 2>/dev/null && "$python" -m pip --version >/dev/null 2>&1; then
        "$python" -m venv --clear --without-pip "$venv" &&
            "$python" -m pip --python "$venv/bin/python" install -q pip && return
    fi
    die "$python can make no virtual environment; install Debian's python$version-venv (or virtualenv) and try again"
}

suitesparse_here() {
    [ -e /usr/include/suitesparse/cholmod.h ] || [ -n "${SUITESPARSE_INCLUDE_DIR:-}" ]
}

python=$(find_python)
say "using $python ($("$python" -V 2>&1))"
if ! { [ -x "$venv/bin/python" ] && usable "$venv/bin/python" && "$venv/bin/python" -m pip --version >/dev/null 2>&1; }; then
    say "making $venv"
    make_venv
fi

say "installing ssdr and what its tests need into $venv (a few minutes the first time)"
extras=alembic,fbx,usd,dev
editable=()
wanted=${EXTRAS:-}
for extra in ${wanted//,/ }; do
    case $extra in
        garmentnet) [ ${#editable[@]} -gt 0 ] || editable=(-e "./garmentnet[onnx]") ;;
        scenes) editable=(-e "./garmentnet[onnx]" "anny>=0.6,<0.7") ;;
        *) extras+=,$extra ;;
    esac
done
if ! "$venv/bin/python" -m pip install -q --disable-pip-version-check --no-input -c .ci/constraints.txt -e ".[$extras]" "${editable[@]}"; then
    die "pip could not install the packages (its own words are above); without network nothing can be set up"
fi

# CHOLMOD is 2 to 5 times faster than SciPy's factorisation, and the package works without it.
if ! "$venv/bin/python" -c 'import sksparse.cholmod' 2>/dev/null; then
    packages=()
    suitesparse_here || packages+=(libsuitesparse-dev)
    "$venv/bin/python" - <<'PY' || packages+=("python$("$venv/bin/python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')-dev")
import os, sys, sysconfig
sys.exit(not os.path.exists(os.path.join(sysconfig.get_paths()["include"], "Python.h")))
PY
    if [ ${#packages[@]} -gt 0 ] && ! install_system "${packages[@]}"; then
        say "the system package(s) ${packages[*]} could not be installed (no root, no apt-get, or no network)"
    fi
    log=$(mktemp)
    if suitesparse_here && "$venv/bin/python" -m pip install -q --disable-pip-version-check --no-input \
        -c .ci/constraints.txt scikit-sparse >"$log" 2>&1; then
        say "CHOLMOD (scikit-sparse) is there"
    else
        say "going on without CHOLMOD: SciPy's factorisation is used instead, slower on large meshes, same results"
        tail -n 3 "$log" | sed 's/^/setup:   /'
    fi
    rm -f "$log"
fi
touch "$venv/.ready"
say "ready"
