#!/bin/bash
# What Pellucid needs from the system: finds what is missing, installs only that, finds a python3.
# Sourced by ./check and ./reproduce; `tools/setup.sh` alone does the same. A complete machine needs
# neither network nor root. Exit 2, with the line to type, where it cannot install.
#
#   PYTHON=…               the python3 that draws the figures (must import what is needed)
#   PELLUCID_SKIP_SETUP=1  trust the machine: install nothing, check no package

pellucid_packages=(
    g++ cmake ninja-build ccache git pkg-config            # the build
    libembree-dev libtbb-dev                               # the truth, threads
    libceres-dev libboost-dev                              # fits, intervals and special functions
    libglm-dev librandom123-dev libfmt-dev                 # vectors, counters, text
    libopenexr-dev libpng-dev zlib1g-dev                   # images
    libnifti-dev libteem-dev libassimp-dev libgts-dev      # volumes, meshes, tessellation
    libtomlplusplus-dev libcli11-dev nlohmann-json3-dev    # scenes, options, summaries
    libhwy-dev                                             # SIMD, chosen at run time
    libvulkan-dev glslc mesa-vulkan-drivers                # Vulkan, shaders, a device in software
    vulkan-validationlayers                                # tests fail on any message of theirs
    libgtest-dev libbenchmark-dev                          # tests, benchmarks
    mricron-data                                           # the real head (ch2.nii.gz)
    python3 python3-numpy python3-scipy python3-pandas python3-matplotlib python3-pil fonts-dejavu-core
)
pellucid_python_modules="numpy, scipy, pandas, matplotlib, PIL"

setup_stop() {
    printf 'set-up: %s\n' "$@" >&2
    exit 2
}

missing_packages() {
    local installed package
    installed=" $(dpkg-query -W -f='${db:Status-Status}=${Package} ' "${pellucid_packages[@]}" 2>/dev/null) "
    for package in "${pellucid_packages[@]}"; do
        case $installed in *" installed=$package "*) ;; *) printf '%s ' "$package" ;; esac
    done
}

# How to become root without asking anybody who is not there: empty as root, else sudo, else fails.
root_prefix() {
    if [ "$(id -u)" = 0 ]; then return 0; fi
    command -v sudo >/dev/null || return 1
    if sudo -n true 2>/dev/null; then echo "sudo -n"
    elif [ -t 0 ] && [ -t 2 ]; then echo "sudo"
    else return 1; fi
}

apt() {  # $1: prefix; the rest: arguments of apt-get
    local prefix=$1
    shift
    $prefix env DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 apt-get -q -y "$@"
}

# Installs $2… with the help of $1. The lists are fetched where there are none of the last day, or
# where they turn out to be too old to install from.
install_packages() {
    local prefix=$1
    shift
    local fresh
    fresh=$(find /var/lib/apt/lists -maxdepth 1 -name '*_Packages*' -mtime -1 2>/dev/null | head -n 1)
    if [ -n "$fresh" ] && apt "$prefix" install --no-install-recommends "$@"; then return 0; fi
    apt "$prefix" update && apt "$prefix" install --no-install-recommends "$@"
}

setup_packages() {
    [ "${PELLUCID_SKIP_SETUP:-}" = 1 ] && return 0
    local system missing prefix log
    system=$(. /etc/os-release 2>/dev/null && echo "${ID:-}-${VERSION_ID:-}")
    case $system in
        debian-12) ;;
        ubuntu-24.04) echo "set-up: Ubuntu 24.04 is best effort and not tested" >&2 ;;
        *) setup_stop "made for Debian 12, this is ${system:-unknown}. Needed, by Debian's names:" \
                      "${pellucid_packages[*]}" "with all of it in place: PELLUCID_SKIP_SETUP=1 $0" ;;
    esac
    missing=$(missing_packages)
    [ -z "$missing" ] && return 0
    prefix=$(root_prefix) ||
        setup_stop "packages are missing and this user cannot install them. As root:" \
                   "apt-get update && apt-get install -y --no-install-recommends ${missing% }"
    echo "set-up: installing ${missing% }"
    log=$(mktemp)
    # shellcheck disable=SC2086  # a list of words
    if ! install_packages "$prefix" $missing >"$log" 2>&1; then
        tail -n 20 "$log" >&2
        rm -f "$log"
        setup_stop "apt-get failed (above). By hand:" \
                   "apt-get update && apt-get install -y --no-install-recommends ${missing% }"
    fi
    rm -f "$log"
}

# Sets PYTHON. The python3 on the PATH may be one that knows nothing of Debian's packages.
setup_python() {
    local candidate found=
    for candidate in ${PYTHON:-python3 /usr/bin/python3}; do
        if "$candidate" -c "import $pellucid_python_modules" >/dev/null 2>&1; then
            found=$(command -v "$candidate")
            break
        fi
    done
    [ -n "$found" ] || setup_stop "${PYTHON:-neither python3 nor /usr/bin/python3} cannot import $pellucid_python_modules"
    export PYTHON=$found
    echo "set-up: figures are drawn by $PYTHON ($("$PYTHON" -c 'import platform; print(platform.python_version())'))"
}

setup_packages
setup_python
