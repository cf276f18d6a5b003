#!/usr/bin/env bash
# The tests of video devices, beside two of the kernel's own and two USB cameras in a guest (run.sh). What follows goes to cargo; without anything:
# -p vergence-capture --features v4l2.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
[ $# -gt 0 ] || set -- -p vergence-capture --features v4l2
VERGENCE_TWIN_PICTURES=$(mktemp -d)
export VERGENCE_TWIN_PICTURES
trap 'rm -rf "$VERGENCE_TWIN_PICTURES"' EXIT
cd "$here/../.."
# The guest computes ten times slower, so the twin's pictures are rendered out here.
cargo test -q --test v4l2 "$@" -- leave_the_twins_pictures
CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER=$here/run.sh cargo test -q --test v4l2 "$@" -- --test-threads=1 --nocapture
