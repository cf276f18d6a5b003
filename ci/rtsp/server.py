#!/usr/bin/python3
"""A pair of network cameras on this machine, for tests: RTSP with GStreamer.

    server.py [--port N] [--width W] [--height H] [--fps F]

Serves /h264/left, /h264/right, /mjpeg/left and /mjpeg/right on 127.0.0.1. A port of 0 (the default) takes a free one. Prints "listening PORT" when
connections are taken, and ends when its standard input does. Commands on standard input, one a line:

    drop      closes every connection: cameras that lose their power
    freeze    goes on with the same picture
    thaw      goes on with new ones
    delay MS  the right camera's pictures are taken so many milliseconds after the left one's

Across the top of every picture stand 32 squares, black or white: the low 32 bits of the monotonic clock in tenths of a millisecond at which the
picture was made, lowest bit first. The left camera's picture moves to the left, the right one's to the right.
"""
import argparse
import sys
import threading
import time

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

BITS = 32
ENCODERS = {
    "h264": "x264enc tune=zerolatency speed-preset=ultrafast bitrate=4000 key-int-max=30 sliced-threads=false threads=1"
    " ! video/x-h264,profile=baseline ! rtph264pay name=pay0 pt=96 config-interval=1",
    "mjpeg": "jpegenc quality=80 ! rtpjpegpay name=pay0 pt=26",
}


class Camera(GstRtspServer.RTSPMediaFactory):
    """One picture that is made again for every frame while somebody looks."""

    def __init__(self, options, encoder, side, orders):
        super().__init__()
        self.options, self.side, self.orders = options, side, orders
        self.set_shared(True)
        self.set_latency(0)
        width, height, fps = options.width, options.height, options.fps
        self.set_launch(
            f"( appsrc name=source is-live=true format=time do-timestamp=true max-buffers=2 leaky-type=downstream"
            f" caps=video/x-raw,format=I420,width={width},height={height},framerate={fps}/1 ! {ENCODERS[encoder]} )"
        )

    def do_configure(self, media):
        source = media.get_element().get_by_name("source")
        threading.Thread(target=self.make, args=(source,), daemon=True).start()

    def make(self, source):
        width, height, fps = self.options.width, self.options.height, self.options.fps
        # A brightness that rises and falls along the rows, twice as long as a row: a slice of it is a row that has moved.
        ramp = bytes(60 + abs((x * 2) % 256 - 128) for x in range(width + 256))
        chroma = bytes([128]) * (width * height // 2)
        square = width // BITS
        period = 1.0 / fps
        count = 0
        # Both cameras keep the same beat: it starts with the machine's clock, not with whoever connected.
        due = (time.monotonic() // period + 1) * period
        while True:
            late = self.orders["delay"] if self.side == "right" else 0.0
            wait = due + late - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            if not self.orders["frozen"]:
                count += 1
                now = int(time.monotonic() * 10_000) & 0xFFFF_FFFF
            step = (count * 4) % 256
            start = step if self.side == "left" else 255 - step
            row = ramp[start : start + width]
            bits = b"".join((b"\xdc" if now >> k & 1 else b"\x1e") * square for k in range(BITS)).ljust(width, b"\x1e")
            luma = bits * 32 + row * (height - 32)
            if source.emit("push-buffer", Gst.Buffer.new_wrapped(luma + chroma)) != Gst.FlowReturn.OK:
                return
            due += period
            # Whoever falls behind leaves pictures out.
            due = max(due, (time.monotonic() // period) * period)


def obey(server, orders, loop):
    for line in sys.stdin:
        words = line.split()
        if words[:1] == ["drop"]:
            GLib.idle_add(lambda: server.client_filter(lambda *_: GstRtspServer.RTSPFilterResult.REMOVE) and False)
        elif words[:1] == ["freeze"]:
            orders["frozen"] = True
        elif words[:1] == ["thaw"]:
            orders["frozen"] = False
        elif words[:1] == ["delay"] and len(words) == 2:
            orders["delay"] = float(words[1]) / 1e3
    loop.quit()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--width", type=int, default=1024)
    parser.add_argument("--height", type=int, default=768)
    parser.add_argument("--fps", type=int, default=30)
    options = parser.parse_args()
    Gst.init(None)
    orders = {"frozen": False, "delay": 0.0}
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(str(options.port))
    for encoder in ENCODERS:
        for side in ("left", "right"):
            server.get_mount_points().add_factory(f"/{encoder}/{side}", Camera(options, encoder, side, orders))
    loop = GLib.MainLoop()
    if server.attach(None) == 0:
        sys.exit("the port is taken")
    print("listening", server.get_bound_port(), flush=True)
    threading.Thread(target=obey, args=(server, orders, loop), daemon=True).start()
    loop.run()


main()
