#!/usr/bin/env bash
# Lets programs that are not ours read a recording: Python's mcap package checks every checksum and decodes every message by the schemas in the file, and PyArrow
# compares the exported Parquet with the CSV. Makes a recording of two seconds when none is given.
#   ci/record/check.sh [RECORDING.mcap]
# PROGRAM names the program (default: cargo run). Needs python3 with venv; what it installs goes to a folder of its own.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
if ! python3 -c 'import ensurepip' 2>/dev/null; then
  apt-get update -qq
  apt-get install -y -qq --no-install-recommends python3-venv
fi
venv=${RECORD_CHECK_VENV:-$work/venv}
if [ ! -x "$venv/bin/python" ]; then
  python3 -m venv "$venv"
  "$venv/bin/pip" install -q mcap mcap-protobuf-support foxglove-schemas-protobuf pyarrow
fi
read -r -a program <<<"${PROGRAM:-cargo run --quiet --manifest-path $here/../../Cargo.toml --}"
file=${1:-}
if [ -z "$file" ]; then
  "${program[@]}" run --fast --headless --seconds 2s --resolution 512x384 --out "$work/runs" >/dev/null
  file=$(echo "$work"/runs/*/recording.mcap)
fi
"${program[@]}" export "$file" --out "$work/export" --no-video --no-pictures >/dev/null
"$venv/bin/python" "$here/check.py" "$file" "$work/export/numbers"
