#!/usr/bin/env bash
# Builds the wheel, installs it into a new environment and tries it.  Run it through `make wheel`.
set -euo pipefail
cd "$(dirname "$0")/.."
rm -rf dist build
.venv/bin/python -m build -q
try=$(mktemp -d)
trap 'rm -rf "$try"' EXIT
.venv/bin/python -m venv "$try/env"
"$try/env/bin/python" -m pip install -q --disable-pip-version-check -c .ci/constraints.txt dist/*.whl
"$try/env/bin/python" -m pip check
cd "$try"
env/bin/python -c 'import ssdr, ssdr.samples; print(ssdr.__version__, ssdr.samples.load())'
env/bin/ssdr --help >/dev/null
ls -l "$OLDPWD/dist"
