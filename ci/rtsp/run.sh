#!/usr/bin/env bash
# Runs a command where ci/rtsp/server.py can run: what it needs (GStreamer with its RTSP server, and Python's way to it) is installed from Debian with
# apt-get when it is missing, which needs root.
#
#   ci/rtsp/run.sh cargo test -p vergence-capture --features rtsp --test rtsp -- --nocapture
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

there() {
  /usr/bin/python3 -c '
import gi
gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import Gst, GstRtspServer
Gst.init(None)
missing = [name for name in ("appsrc", "x264enc", "jpegenc", "rtph264pay", "rtpjpegpay") if not Gst.ElementFactory.find(name)]
raise SystemExit(bool(missing))' 2>/dev/null
}
if ! there; then
  apt-get update -qq >&2
  apt-get install -y -qq --no-install-recommends python3-gi gir1.2-gst-rtsp-server-1.0 gstreamer1.0-plugins-base gstreamer1.0-plugins-good \
    gstreamer1.0-plugins-ugly >/dev/null
  there || { echo "rtsp: GStreamer was installed and does not work" >&2; exit 125; }
fi
export VERGENCE_RTSP_SERVER=$here/server.py
exec "$@"
