#!/usr/bin/env bash
# The Python package as a user gets it: a wheel in a fresh environment, the Python of README and docs, the tests, the examples.
set -euo pipefail
cd "$(dirname "$0")"
cargo fmt --check
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -c 'import sys; sys.exit(sys.version_info < (3, 10) and "it needs Python 3.10")'
python3 -m venv "$work/venv"
venv=$work/venv/bin
# pin and example-robot-data are Pinocchio, for a comparison.
"$venv/pip" -q install 'maturin>=1.9,<2' "${DBBD_NUMPY:-numpy}" pytest mypy pin example-robot-data
PATH=$venv:$PATH maturin build --release --locked --quiet --out "$work/wheel"
"$venv/pip" -q install --no-deps "$work"/wheel/*.whl
"$venv/dbbd" --version
# The types that the stubs state are those of the module.
(cd "$work" && "$venv/python" -m mypy.stubtest dbbd)
# The Python of the documents, each document's blocks as one program in the repository.
for page in ../README.md ../docs/how-to/python.md; do
    awk '/^```python$/ { on = 1; next } /^```$/ { on = 0 } on' "$page" >"$work/page.py"
    (cd .. && "$venv/python" -W error "$work/page.py")
done
DBBD_RUST_FK_S=$(cargo run --release --locked --quiet --example fk)
export DBBD_RUST_FK_S
"$venv/python" -m pytest -q -rs -s -p no:cacheprovider tests
for example in examples/*.py; do
    "$venv/python" "$example"
done
