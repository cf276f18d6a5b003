#!/usr/bin/env bash
# The driver's tests and the closed loop on a real LinuxCNC, in half a minute beside building: needs root, see ci/linuxcnc/run.
# Arguments go to cargo instead of --workspace: -p vergence-control -p vergence --profile quick
set -euo pipefail
cd "$(dirname "$0")/../.."
[ $# -gt 0 ] || set -- --workspace
cargo test --quiet "$@" --test linuxcnc --test linuxcnc_loop --no-run
# Each has a controller of its own, so both go at once. The driver's tests compute next to nothing and go first (12; what `run` starts has 10).
first=()
chrt --rr 12 true 2>/dev/null && first=(chrt --rr 12)
loop_log=$(mktemp)
ci/linuxcnc/run cargo test --quiet --offline "$@" --test linuxcnc_loop -- --nocapture >"$loop_log" 2>&1 &
loop=$!
trap 'kill "$loop" 2>/dev/null || true; rm -f "$loop_log"' EXIT
status=0
ci/linuxcnc/run "${first[@]}" cargo test --quiet --offline "$@" --test linuxcnc -- --nocapture || status=$?
wait "$loop" || status=$?
cat "$loop_log"
exit "$status"
