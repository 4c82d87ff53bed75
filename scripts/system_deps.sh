#!/bin/sh
# Installs what the system must provide, when something is missing and we are root; otherwise
# names it with the command to type. Usage: system_deps.sh [PYTHON [PACKAGE...]]
#
#   libegl1, libgl1-mesa-dri,
#   libopengl0                 rendering without a display; missing: warned, nothing else fails
#   chromium                   only if named: tests of the web viewer; missing: they are skipped
#   slurmctld, slurmd, slurm-client, munge   only if named: tests of sweeps on Slurm; likewise
#   pythonX.Y-venv             Debian keeps venv's pip apart; missing: nothing can go on (exit 1)
set -eu

python=${1:-python3}
[ $# -eq 0 ] || shift
more="$*"
packages=""
blocked=0

if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    packages="python$version-venv"
    blocked=1
fi

if ! command -v dpkg-query >/dev/null; then
    if ! "$python" -c 'import ctypes; ctypes.CDLL("libEGL.so.1")' 2>/dev/null; then
        echo "warning: no libEGL.so.1: pictures without a display need EGL and Mesa's drivers" >&2
    fi
    [ -z "$packages" ] || echo "error: '$python -m venv' needs pip's bundle (ensurepip)" >&2
    exit $blocked
fi

for package in libegl1 libgl1-mesa-dri libopengl0 $more; do
    status=$(dpkg-query --show --showformat='${db:Status-Status}' "$package" 2>/dev/null) || true
    [ "$status" = installed ] || packages="$packages $package"
done
packages=${packages# }
[ -n "$packages" ] || exit 0

command="apt-get install -y --no-install-recommends $packages"
if [ "$(id -u)" -eq 0 ]; then
    echo "system packages missing: $packages"
    # No quotes: every word of it is an argument.
    if apt-get update && DEBIAN_FRONTEND=noninteractive $command; then
        exit 0
    fi
    echo "could not install: $packages. By hand: $command" >&2
else
    echo "system packages missing: $packages. To install them: sudo $command" >&2
fi
[ $blocked -eq 0 ] || exit 1
echo "warning: without libegl1, libgl1-mesa-dri, libopengl0 there are no pictures without a display," >&2
[ -z "$more" ] || echo "         without $more some tests are skipped" >&2
