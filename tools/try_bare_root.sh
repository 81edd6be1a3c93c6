#!/bin/bash
# Does a machine with nothing but git and a shell get from a clone to passing checks? Makes a bare
# Debian 12 root, clones the current commit into it, and runs ./reproduce --build-only and ./check there.
#
#   tools/try_bare_root.sh [COMMAND…]     as root; needs debootstrap, the network, 4 GB in $TMPDIR or /tmp
#   MIRROR=URL                            where packages come from (default http://deb.debian.org/debian)
#
# The root is deleted at the end. Mounts live in a namespace of their own and vanish with it.
set -euo pipefail
mirror=${MIRROR:-http://deb.debian.org/debian}
[ "$(id -u)" = 0 ] || { echo "try_bare_root: has to run as root" >&2; exit 2; }
command -v debootstrap >/dev/null || { echo "try_bare_root: debootstrap is missing" >&2; exit 2; }
repository=$(dirname "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")")
[ $# -gt 0 ] || set -- "./reproduce --build-only" "./check"

bare=$(mktemp -d)
chmod 755 "$bare"
trap 'rm -rf --one-file-system "$bare"' EXIT

# What the commands below say and how long they take is the result.
inside() {
    local start=$SECONDS code=0
    echo "== $*"
    unshare --mount bash -c 'mount -t proc proc "$1/proc" && exec chroot "$1" /usr/bin/env -i \
        PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 bash -c "$2"' _ "$bare" "$*" || code=$?
    echo "== exit $code after $((SECONDS - start)) s"
    return "$code"
}

debootstrap --variant=minbase bookworm "$bare" "$mirror" >/dev/null

# The host's way to the network, nothing else of it.
cp /etc/resolv.conf /etc/hosts "$bare/etc/"
apt-config dump | grep -E '^Acquire::(https?::.*Proxy|Check-)' >"$bare/etc/apt/apt.conf.d/90host" || true

git -C "$repository" bundle create -q "$bare/root/pellucid.bundle" HEAD
inside "apt-get update -qq && apt-get install -qq -y --no-install-recommends git >/dev/null 2>&1"
# The lists go as well: set-up has to fetch its own.
inside "rm -rf /var/lib/apt/lists/* && git -c advice.detachedHead=false clone -q /root/pellucid.bundle /root/pellucid"
for command in "$@"; do
    inside "cd /root/pellucid && $command"
done
inside "cd /root/pellucid && git status --short && du -sh /usr build"
