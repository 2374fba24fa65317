#!/usr/bin/env bash
# Makes .venv with exactly what requirements.lock says, and softbot itself in place. Called by make.
#   set_up.sh STAMP      touches STAMP when all is done
# PYTHON=/path/to/python3 takes that interpreter.
set -euo pipefail
cd "$(dirname "$0")/.."
stamp=$1

fail() {
  printf 'softbot: %s\n' "$@" >&2
  exit 1
}

new_enough() {
  command -v "$1" >/dev/null && "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null
}

# 3.11 goes first: PyBullet is published ready-built for no later one.
python=
for name in ${PYTHON:-python3.11 python3 python3.12 python3.13}; do
  if new_enough "$name"; then
    python=$name
    break
  fi
done
[ -n "$python" ] || fail \
  "Python 3.11 or newer is needed; here is ${PYTHON:-$(python3 --version 2>/dev/null || echo none)}." \
  "Install one (apt install python3.11 python3.11-venv), or name one: make PYTHON=/path/to/python3.11 ..."

version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
"$python" -c 'import ensurepip, venv' 2>/dev/null || fail \
  "Python $version is here without its venv module: apt install python$version-venv (or python3-venv)."

if [ "$version" != 3.11 ]; then
  echo "softbot: PyBullet has to be compiled for Python $version, which takes minutes; Python 3.11 needs none of it."
  headers=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
  if ! command -v c++ >/dev/null || [ ! -e "$headers/Python.h" ]; then
    fail "That needs a C++ compiler and Python's headers: apt install build-essential python$version-dev."
  fi
fi

if ! .venv/bin/python -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$version')" 2>/dev/null; then
  echo "softbot: making .venv with Python $version"
  "$python" -m venv --clear .venv || fail \
    "The environment could not be made: is python$version-venv installed (apt install python$version-venv)?"
fi
echo 'softbot: installing what requirements.lock says (some minutes the first time)'
pip() { .venv/bin/python -m pip --disable-pip-version-check --no-input --quiet "$@"; }
pip install --require-hashes -r requirements.lock || fail \
  'The packages could not be installed (see above). Is the package index reachable?'
if ! command -v cc gcc clang >/dev/null; then
  echo 'softbot: no C compiler here; installing the one of the package ziglang (100 MB) for the C reference'
  pip install --require-hashes -r .ci/c_compiler.txt || fail \
    'The C compiler could not be installed (see above): apt install gcc libc6-dev is the other way.'
fi
pip install --no-deps -e . || fail 'softbot itself could not be installed (see above).'
touch "$stamp"
