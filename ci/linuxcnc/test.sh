#!/usr/bin/env bash
# The driver's tests and the closed loop on a real LinuxCNC, in under a minute beside building: needs root, see ci/linuxcnc/run.
# Arguments go to cargo instead of --workspace: -p vergence-control -p vergence --profile quick
set -euo pipefail
cd "$(dirname "$0")/../.."
[ $# -gt 0 ] || set -- --workspace
cargo test --quiet "$@" --test linuxcnc --test linuxcnc_loop --no-run
# Each has a controller of its own: what one leaves would not be there for the other.
ci/linuxcnc/run cargo test --quiet --offline "$@" --test linuxcnc -- --nocapture
ci/linuxcnc/run cargo test --quiet --offline "$@" --test linuxcnc_loop -- --nocapture
