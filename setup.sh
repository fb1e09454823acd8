#!/bin/sh
# Brings this checkout to life on a bare Debian or Ubuntu machine: system libraries through apt, Python packages from the
# hash-pinned requirements.lock into .venv. Does only what is missing; takes well under a second when nothing is.
set -eu
cd "$(dirname "$0")"

say() { printf 'setup: %s\n' "$*"; }
fail() { printf 'setup: %s\n' "$*" >&2; exit 2; }

# --- system libraries: headless rendering (EGL, Mesa's software driver), OpenMP, the camera's USB library -----------
has_library() { find /lib /usr/lib -name "$1*" 2>/dev/null | grep -q .; }

missing=""
has_library libEGL.so.1 || missing="$missing libegl1"
has_library libEGL_mesa.so.0 || missing="$missing libegl-mesa0"
has_library swrast_dri.so || has_library libgallium || missing="$missing libgl1-mesa-dri"
has_library libOpenGL.so.0 || missing="$missing libopengl0"
has_library libgomp.so.1 || missing="$missing libgomp1"
has_library libusb-1.0.so.0 || missing="$missing libusb-1.0-0"

if [ -n "$missing" ]; then
    command -v apt-get >/dev/null || fail "these system libraries are missing, and there is no apt-get to install them:$missing"
    sudo=""
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null || fail "run once as root: apt-get install -y$missing"
        sudo="sudo"
    fi
    say "installing system libraries:$missing"
    $sudo apt-get update -qq
    # shellcheck disable=SC2086  # a list of package names
    DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq --no-install-recommends $missing >/dev/null
fi

# --- Python packages ---------------------------------------------------------------------------------------------------
command -v uv >/dev/null || fail "uv is missing: python3 -m pip install uv rust-just"
stamp=.venv/.installed
wanted="$(cat requirements.lock pyproject.toml setup.sh | sha256sum | cut -d' ' -f1)"
if [ "$(cat "$stamp" 2>/dev/null || true)" != "$wanted" ]; then
    [ -x .venv/bin/python ] || uv venv --quiet --python '>=3.11' .venv
    say "installing the Python packages of requirements.lock into .venv (about 1.2 GB; a minute or two)"
    uv pip sync --quiet --compile-bytecode --python .venv --require-hashes requirements.lock
    uv pip install --quiet --python .venv --no-deps --no-build-isolation --editable .
    printf '%s\n' "$wanted" >"$stamp"
    say "done"
fi
