#!/usr/bin/env bash
# Makes the environment .venv with scenetruth in it, and installs OSMesa where that is allowed. Safe to repeat.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { printf 'setup: %s\n' "$*"; }

# Runs a command as root, if we are root or may become it without a password.
as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        "$@"
    elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
        sudo -n "$@"
    else
        return 1
    fi
}

apt_install() {
    command -v apt-get >/dev/null 2>&1 || return 1
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@" >/dev/null 2>&1 ||
        { as_root apt-get update -q >/dev/null 2>&1 &&
            as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends "$@" >/dev/null 2>&1; }
}

find_python() {
    for candidate in "${PYTHON:-}" python3 python3.14 python3.13 python3.12 python3.11; do
        if [ -n "$candidate" ] && command -v "$candidate" >/dev/null 2>&1 &&
            "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v "$candidate"
            return 0
        fi
    done
    return 1
}

if ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
    python=$(find_python) || { say "needs Python 3.11 or newer (set PYTHON=/path/to/python3)" >&2; exit 1; }
    say "making .venv with $python"
    rm -rf .venv
    if ! "$python" -m venv .venv >/dev/null 2>&1; then
        version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
        say "this Python lacks venv; installing python$version-venv"
        apt_install "python$version-venv" || apt_install python3-venv || true
        rm -rf .venv
        "$python" -m venv .venv || { say "cannot make .venv; install python3-venv" >&2; exit 1; }
    fi
fi

# The system's packages come while Python's do.
has_osmesa() { .venv/bin/python -c 'import ctypes.util, sys; sys.exit(ctypes.util.find_library("OSMesa") is None)'; }
install_osmesa() {
    has_osmesa && return
    say "installing the system library libosmesa6"
    if ! apt_install libosmesa6 || ! has_osmesa; then
        say "libosmesa6 could not be installed (not root, or no such package): pyrender will use EGL, or ray casting renders"
    fi
}
install_osmesa &

# The version is told when it is installed: anew whenever a release is reached or left behind, not at every commit.
release() { git describe --tags --exact-match 2>/dev/null || printf 'after %s\n' "$(git describe --tags --abbrev=0 2>/dev/null)"; }

# The demo needs less than the tests, and comes first.
installed() { [ "$(cat ".venv/scenetruth-$1" 2>/dev/null)" = "$wanted" ]; }
pip() { .venv/bin/python -m pip "$@"; }
quiet=(-q --disable-pip-version-check)
# Old versions of pip cannot make a wheel of a package without a pyproject.toml (there is one among those of the tests)
# unless they are told; new ones do nothing else, and know no such option.
export PIP_USE_PEP517=1

# Installs scenetruth and what it and some extras (named with commas between) need, on all processors, for pip works on
# one: what is needed is found once, then several pips unpack it, each its own share.
install_beside() {
    local wheels=.venv/wheels processes n job jobs=() wheel_files
    processes=$(nproc 2>/dev/null || echo 1)
    [ "$processes" -le 4 ] || processes=4
    rm -rf "$wheels"
    mkdir -p "$wheels"
    .venv/bin/python - "$1" >"$wheels/needed.txt" <<'END' || return 1
import sys, tomllib
project = tomllib.load(open("pyproject.toml", "rb"))["project"]
extras = [line for name in sys.argv[1].split(",") for line in project["optional-dependencies"][name]]
print(*project["dependencies"], *extras, sep="\n")
END
    pip install "${quiet[@]}" "$bytecode" --no-deps -e . &
    jobs=($!)
    pip wheel "${quiet[@]}" -w "$wheels" -r "$wheels/needed.txt" || return 1
    for ((n = 0; n < processes; n++)); do
        mapfile -t wheel_files < <(ls -S "$wheels"/*.whl | awk -v n="$n" -v of="$processes" 'NR % of == n')
        [ "${#wheel_files[@]}" -gt 0 ] || continue
        pip install "${quiet[@]}" "$bytecode" --no-deps --no-index "${wheel_files[@]}" &
        jobs+=($!)
    done
    for job in "${jobs[@]}"; do wait "$job" || return 1; done
}

install() {
    # What is used is compiled when it is first imported: to compile all of it takes longer than all the rest. Where
    # nothing that is imported may be kept, every start would compile it again.
    bytecode=--no-compile
    [ -z "${PYTHONDONTWRITEBYTECODE:-}" ] || bytecode=--compile
    # Whatever went wrong the quick way, the plain way mends it or tells.
    install_beside "$2" 2>/dev/null || { wait; pip install "${quiet[@]}" "$bytecode" -e ".[$2]"; }
    # What is installed has its metadata in .venv. With a second copy next to the sources, where the build leaves it,
    # pytest rewrites the asserts of all modules, and compiles each a second time.
    rm -rf .venv/wheels src/scenetruth.egg-info
    printf '%s\n' "$wanted" >".venv/scenetruth-$1"
}
wanted=$(cksum pyproject.toml; pwd; release)
if [ "${1:-}" = demo ]; then
    if ! installed installed && ! installed runs; then
        say "installing scenetruth and what it needs into .venv"
        install runs opengl
    fi
elif ! installed installed; then
    say "installing scenetruth, what it needs and what its tests need into .venv"
    install installed opengl,datasets,design,test
fi

wait

if [ "${1:-}" = browser ]; then
    say "installing playwright and, where that is allowed, the system package chromium"
    .venv/bin/python -m pip install -q --disable-pip-version-check -e '.[browser]'
    command -v chromium >/dev/null 2>&1 || apt_install chromium ||
        say "chromium could not be installed (not root, or no such package): tests of pages are skipped"
fi

if [ "${1:-}" = docs ] && ! .venv/bin/python -c 'import mathjax, myst_nb, notfound, pydata_sphinx_theme, sphinx_copybutton, sphinx_design' 2>/dev/null; then
    say "installing what builds the site"
    .venv/bin/python -m pip install -q --disable-pip-version-check -e '.[docs]'
fi
