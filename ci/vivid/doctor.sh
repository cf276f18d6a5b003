#!/usr/bin/env bash
# `vergence doctor` beside two cameras of the kernel's own in a guest (run.sh): they are asked what they can do, opened as a pair and measured.
# What follows goes to cargo, as features that share a build do; without anything: -p vergence --features v4l2.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
[ $# -gt 0 ] || set -- -p vergence --features v4l2
cd "$here/../.."
cargo build -q "$@" --bin vergence
said=$(mktemp)
trap 'rm -f "$said"' EXIT
# Exit code 1: something of the guest itself may be wrong, such as the room on its disk.
"$here/run.sh" "${CARGO_TARGET_DIR:-target}/debug/vergence" doctor --no-speed --source v4l2 --left /dev/video0 --right /dev/video1 --size 640x480 --fps 25 |
  tee "$said" || [ "${PIPESTATUS[0]}" = 1 ]
for words in \
  'left /dev/video0: vivid, driver vivid; sends YUYV, .*RGB3.* (.*640x480 at 25/15/.* Hz' \
  'left /dev/video0: YUYV 640x480, 25 a second by its own account; came [12][0-9]\.' \
  'right /dev/video1: YUYV 640x480, 25 a second by its own account; came [12][0-9]\.' \
  'controls: the same on both: .*brightness' \
  'pair: [0-9]* pairs in 3\.[0-9] s, skew .* where 8\.0 ms are allowed' \
  'offset: ' '-> '; do
  grep -q -e "$words" "$said" || { echo "doctor did not say: $words" >&2; exit 1; }
done
