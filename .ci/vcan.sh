#!/usr/bin/env bash
# Runs a command where SocketCAN's vcan0 and vcan1 are up, or fails: it never skips.
#   .ci/vcan.sh [-t SECONDS] COMMAND [ARGUMENT...]
#
# Where the kernel has vcan, in a network namespace of its own (or, where none may be made, on the host's own vcan0 and
# vcan1). Where it has not, in a User-Mode Linux kernel: an ordinary process, up in two seconds, one CPU, clock and
# memory of the host. COMMAND sees this file system read-only, but for this checkout and $XDG_CACHE_HOME; /run, /dev/shm
# and $TMPDIR are in memory. It has this environment and SOFTBOT_VCAN=1.
# Exit status: COMMAND's; 124 when SECONDS (default 1200) ran out; 125 when no vcan could be had.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
checkout=$(dirname "$here")
limit=1200
if [ "${1:-}" = -t ]; then
  limit=$2
  shift 2
fi
[ $# -gt 0 ] || { echo "usage: $0 [-t SECONDS] COMMAND [ARGUMENT...]" >&2; exit 2; }

say() { echo "vcan: $*" >&2; }

# The machine's own scheduler must not be what is measured: real-time priority where it may be had.
urgent() {
  if chrt -f 5 true 2>/dev/null; then chrt -f 5 "$@"; else "$@"; fi
}

# shellcheck disable=SC2016
bring_up='for name in vcan0 vcan1; do ip link add dev $name type vcan && ip link set $name up || exit 125; done
ip link set lo up'

own_kernel() {
  local namespace
  for namespace in "unshare --net" "unshare --net --map-root-user"; do
    if $namespace sh -c "$bring_up" 2>/dev/null; then
      say "this kernel's, in a network namespace of its own"
      SOFTBOT_VCAN=1 timeout -k 5 "$limit" $namespace sh -c "$bring_up"' && exec "$@"' sh "$@"
      exit
    fi
  done
  if [ -e /sys/class/net/vcan0 ] && [ -e /sys/class/net/vcan1 ]; then
    say "this machine's vcan0 and vcan1"
    SOFTBOT_VCAN=1 timeout -k 5 "$limit" "$@"
    exit
  fi
}

get_packages() {
  local missing=()
  [ -x /usr/bin/linux.uml ] || missing+=(user-mode-linux)
  [ -x /bin/busybox ] || missing+=(busybox-static)
  command -v cc >/dev/null || missing+=(gcc libc6-dev)
  [ ${#missing[@]} -gt 0 ] || return 0
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    say "installing ${missing[*]}"
    apt-get update -qq >&2
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" </dev/null >&2 || {
      say "these packages could not be installed: ${missing[*]}"
      exit 125
    }
    return 0
  fi
  say "this kernel has no vcan, and User-Mode Linux is not here."
  say "Either:  sudo modprobe vcan        (a kernel with CAN support)"
  say "or:      sudo apt-get install --no-install-recommends ${missing[*]}"
  exit 125
}

user_mode_linux() {
  job=$(mktemp -d "${TMPDIR:-/tmp}/softbot-vcan.XXXXXX")
  trap 'rm -rf "$job"' EXIT
  trap 'exit 130' INT TERM
  cc -O2 -shared -fPIC -o "$job/whole_xstate.so" "$here/whole_xstate.c"
  local cache=${XDG_CACHE_HOME:-$HOME/.cache}/softbot
  mkdir -p "$cache"
  {
    export -p | grep -v -E '^declare -x (TMPDIR|HOME|PWD|OLDPWD|SHLVL|LD_PRELOAD)='
    printf 'export SOFTBOT_VCAN=1 HOME=/run/tmp TMPDIR=/run/tmp XDG_CACHE_HOME=%q\n' "${cache%/softbot}"
    printf 'cd %q || exit 125\nexec' "$PWD"
    printf ' %q' "$@"
    echo
  } >"$job/command"
  cat >"$job/init" <<END
#!/bin/busybox sh
bb() { /bin/busybox "\$@"; }
give_up() { bb echo "\$*" >"$job/failed"; bb poweroff -f; }
bb mount -t proc proc /proc; bb mount -t sysfs sys /sys
bb mount -t tmpfs tmp /run; bb mkdir -p /run/tmp /dev/pts /dev/shm
bb mount -t devpts pts /dev/pts; bb mount -t tmpfs shm /dev/shm
for folder in "$job" "$checkout" "$cache"; do
  bb mount -t hostfs -o "\$folder" hostfs "\$folder" || bb poweroff -f
done
modules=\$(bb find /usr/lib/uml/modules -name kernel -type d | bb head -n 1)
for module in net/can/can net/can/can-raw net/can/can-bcm net/can/can-gw drivers/net/can/dev/can-dev drivers/net/can/vcan
do bb insmod "\$modules/\$module.ko" || give_up "cannot load \$module"; done
bb ip link set lo up
# One processor for all: what asks for real-time priority in here is not held up for 50 ms of every second.
bb echo -1 >/proc/sys/kernel/sched_rt_runtime_us
for name in vcan0 vcan1; do
  bb ip link add \$name type vcan && bb ip link set \$name up || give_up "cannot make \$name"
done
bb stty -onlcr </dev/tty1
/bin/bash "$job/command" </dev/null >/dev/tty1 2>&1
bb echo \$? >"$job/status"
bb sync; bb poweroff -f
END
  chmod +x "$job/init"
  say "User-Mode Linux: this machine's kernel has none"
  local status=0
  # The kernel's own memory is a file: in memory, or it would be the disk's speed that is measured.
  TMPDIR=/dev/shm LD_PRELOAD=$job/whole_xstate.so urgent timeout -k 5 "$limit" /usr/bin/linux.uml mem=1500M \
    umid=softbot uml_dir="$job/" root=none rootfstype=hostfs rootflags=/ ro init="$job/init" \
    con=null con0=null,fd:2 con1=null,fd:1 ssl=null quiet loglevel=1 </dev/null 2>"$job/console" || status=$?
  if [ -s "$job/status" ]; then exit "$(cat "$job/status")"; fi
  if [ $status = 124 ] || [ $status = 137 ]; then
    say "stopped after $limit s"
    exit 124
  fi
  cat "$job/console" "$job/failed" >&2 2>/dev/null || true
  say "User-Mode Linux did not come up"
  exit 125
}

own_kernel "$@"
get_packages
user_mode_linux "$@"
