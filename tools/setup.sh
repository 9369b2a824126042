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

pip() { .venv/bin/python -m pip "$@"; }
quiet=(-q --disable-pip-version-check)
# Old versions of pip cannot make a wheel of a package without a pyproject.toml (there is one among those of the tests)
# without this setting; new versions do so anyway, and have no such option.
export PIP_USE_PEP517=1

if ! .venv/bin/python -c '' >/dev/null 2>&1; then
    python=$(find_python) || { say "needs Python 3.11 or newer (set PYTHON=/path/to/python3)" >&2; exit 1; }
    say "making .venv with $python"
    rm -rf .venv
    # pip comes with what is installed: ensurepip takes longer than to find and fetch all packages.
    "$python" -m venv --without-pip .venv >/dev/null 2>&1 || rm -rf .venv
fi

add_pip() {
    local python version
    pip --version >/dev/null 2>&1 || .venv/bin/python -m ensurepip >/dev/null 2>&1 && return
    python=$(find_python)
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    say "this Python lacks venv; installing python$version-venv" >&2
    apt_install "python$version-venv" || apt_install python3-venv || true
    rm -rf .venv
    "$python" -m venv .venv || { say "cannot make .venv; install python3-venv" >&2; exit 1; }
}

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

# Prints the path of uv, which finds, fetches and unpacks packages on all processors, in less than half of the processor
# time of pip. Where it is not at hand, pip fetches it: that of the Python that made the environment, or a new one.
find_uv() {
    local uv
    for uv in .venv/bin/uv "$(command -v uv)"; do
        if "$uv" --version >/dev/null 2>&1; then
            printf '%s\n' "$uv"
            return
        fi
    done
    { "$(find_python)" -m pip --python .venv/bin/python install "${quiet[@]}" --no-compile uv ||
        { add_pip && pip install "${quiet[@]}" --no-compile uv; }; } >/dev/null 2>&1
    .venv/bin/uv --version >/dev/null && printf '.venv/bin/uv\n'
}

# uv takes packages from where pip takes them.
pip_setting() { sed -n "s/^[^=]*[.]$1='\(.*\)'\$/\1/p" <<<"$settings" | tail -n 1 | sed 's/\\n/ /g'; }
export_setting() { [ -z "$2" ] || [ -n "${!1:-}" ] || export "$1=$2"; }
install_with_uv() {
    local uv settings
    uv=$(find_uv) || return 1
    settings=$({ pip config list || "$(find_python)" -m pip config list; } 2>/dev/null) || return 1
    export_setting UV_DEFAULT_INDEX "$(pip_setting index-url)"
    export_setting UV_INDEX "$(pip_setting extra-index-url)"
    export_setting UV_FIND_LINKS "$(pip_setting find-links | tr ' ' ,)"
    export_setting UV_CONSTRAINT "$(pip_setting constraint)"
    export_setting UV_NO_INDEX "$(pip_setting no-index)"
    export_setting SSL_CERT_FILE "$(pip_setting cert)"
    export_setting UV_INDEX_STRATEGY unsafe-best-match
    UV_NATIVE_TLS=1 UV_SYSTEM_CERTS=1 "$uv" pip install -q --python .venv/bin/python "$bytecode-bytecode" \
        pip -e ".[$1]"
}

install() {
    # What is used is compiled when it is first imported: to compile all of it takes longer than all the rest. Where
    # nothing that is imported may be kept, every start would compile it again.
    bytecode=--no-compile
    [ -z "${PYTHONDONTWRITEBYTECODE:-}" ] || bytecode=--compile
    # Whatever went wrong the quick way, the plain way mends it or tells.
    install_with_uv "$2" 2>/dev/null || { add_pip && pip install "${quiet[@]}" "$bytecode" -e ".[$2]"; }
    # What is installed has its metadata in .venv. With a second copy next to the sources, where the build leaves it,
    # pytest rewrites the asserts of all modules, and compiles each a second time.
    rm -rf src/scenetruth.egg-info
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
