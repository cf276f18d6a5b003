#!/usr/bin/env bash
# Runs a program beside real video devices on a machine that has none: Debian's own kernel is started in QEMU with a small file system in
# memory, `vivid` (the kernel's virtual video driver) makes two cameras and two outputs, the program runs there, and its exit status comes back.
# `vhci-hcd` (the kernel's virtual USB host) and `uvcvideo` (its driver of USB cameras) are there, too: a program that speaks USB/IP on a socket is a
# USB device, as the tests' own cameras are (crates/capture/tests/v4l2/uvc).
#
#   ci/vivid/run.sh PROGRAM [ARGUMENTS...]
#
# As a runner of cargo:
#   CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER=ci/vivid/run.sh cargo test -p vergence-capture --features v4l2 --test v4l2
#
# What is missing is installed from Debian with apt-get (that needs root). The kernel is fetched once and unpacked, never installed:
# 70 MB to download, of which the kernel and some modules stay in ${XDG_CACHE_HOME:-~/.cache}/vergence-vivid.
#
# In the guest: /dev/video0 and /dev/video1 take pictures (input 0 a webcam, input 1 HDMI), /dev/video2 and /dev/video3 are the outputs of the
# same two drivers; USB cameras come behind these, two nodes each. VIVID_SECONDS (default 150) is how long the guest may take. Variables that
# begin with VERGENCE_ are passed on; the folder VERGENCE_TWIN_PICTURES is copied.
# Exit status: the program's; 124 when it took too long, 125 when there is no guest or it died.
set -euo pipefail

[ $# -gt 0 ] || { sed -n '2,8p' "$0" >&2; exit 125; }
seconds=${VIVID_SECONDS:-150}
cache=${XDG_CACHE_HOME:-$HOME/.cache}/vergence-vivid
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
started=$(date +%s%N)
since() { awk "BEGIN { printf \"%.1f\", ($(date +%s%N) - $1) / 1e9 }"; }

# What has to be there. A name of a program, then the package that brings it.
missing=()
while read -r program package; do
  command -v "$program" >/dev/null || missing+=("$package")
done <<'PACKAGES'
qemu-system-x86_64 qemu-system-x86
modprobe kmod
cpio cpio
v4l2-ctl v4l-utils
PACKAGES
[ -x /bin/busybox ] && ! ldd /bin/busybox >/dev/null 2>&1 || missing+=(busybox-static)
if [ ${#missing[@]} -gt 0 ]; then
  apt-get update -qq >&2
  apt-get install -y -qq --no-install-recommends "${missing[@]}" >"$work/apt" 2>&1 || { tail -5 "$work/apt" >&2; exit 125; }
fi

# The kernel. Whoever comes second waits for the one that fetches it. What is kept of it has a number, so that a folder with less is filled anew.
ready=$cache/ready-2
mkdir -p "$cache"
exec 9>"$cache/lock"
flock 9
if [ ! -e "$ready" ]; then
  kernel_package() {
    apt-cache depends linux-image-amd64 2>/dev/null | sed -n 's/.*Depends: \(linux-image-[^ ]*\).*/\1/p' | head -n 1
  }
  package=$(kernel_package)
  [ -n "$package" ] || { apt-get update -qq >&2; package=$(kernel_package); }
  [ -n "$package" ] || { echo "vivid: apt knows no linux-image-amd64" >&2; exit 125; }
  mkdir "$work/deb"
  (cd "$work/deb" && apt-get download -qq -o APT::Sandbox::User=root "$package" >&2)
  dpkg-deb --fsys-tarfile "$work"/deb/*.deb |
    tar -x -C "$work/deb" --wildcards './boot/vmlinuz-*' './lib/modules/*/modules.*' './lib/modules/*/kernel/lib' './lib/modules/*/kernel/fs' \
      './lib/modules/*/kernel/drivers/media' './lib/modules/*/kernel/drivers/video' './lib/modules/*/kernel/drivers/gpu' \
      './lib/modules/*/kernel/drivers/usb'
  depmod -b "$work/deb" "$(ls "$work/deb/lib/modules")"
  rm -rf "$cache/boot" "$cache/lib" "$work"/deb/*.deb
  mv "$work/deb/boot" "$work/deb/lib" "$cache/"
  touch "$ready"
fi
flock -u 9
version=$(ls "$cache/lib/modules")
fetched=$(since "$started")

# The file system: busybox, the modules in the order in which they are loaded, the programs with the libraries that they name.
root=$work/root
mkdir -p "$root"/{bin,dev,proc,sys,tmp,modules}
cp /bin/busybox "$root/bin/busybox"
with_libraries() {
  cp -L "$1" "$root/bin/"
  ldd "$1" 2>/dev/null | sed -n 's#^[^/]*\(/[^ ]*\) (0x.*#\1#p' | while read -r library; do
    mkdir -p "$root$(dirname "$library")"
    cp -Ln "$library" "$root$library"
  done
}
with_libraries "$1"
with_libraries "$(command -v v4l2-ctl)"
strip "$root/bin/$(basename "$1")" 2>/dev/null || true
modprobe -d "$cache" -S "$version" --show-depends -a vivid vhci-hcd uvcvideo | sed -n 's/^insmod \([^ ]*\).*/\1/p' |
  awk '!seen[$0]++' >"$work/order"
number=100
while read -r module; do
  cp "$module" "$root/modules/$((number++))-$(basename "$module")"
done <"$work/order"
program=/bin/$(basename "$1")
shift
printf '%q ' exec "$program" "$@" >"$root/run"
for name in $(compgen -e | grep '^VERGENCE_\|^RUST_BACKTRACE$' || true); do
  printf 'export %s=%q\n' "$name" "${!name}" >>"$root/environment"
done
touch "$root/environment"
if [ -d "${VERGENCE_TWIN_PICTURES:-}" ]; then
  mkdir -p "$root$VERGENCE_TWIN_PICTURES"
  cp "$VERGENCE_TWIN_PICTURES"/*.png "$root$VERGENCE_TWIN_PICTURES/" 2>/dev/null || true
fi
# One plane a picture. node_types: capture and output. Two inputs (webcam 0, HDMI 3: two bits each, the first lowest), one output (HDMI).
# no_error_inj=0 gives the controls that plant faults.
cat >"$root/init" <<'INIT'
#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin HOME=/tmp
mount -t devtmpfs dev /dev; mount -t proc proc /proc; mount -t sysfs sys /sys
mark() { read -r up _ </proc/uptime; echo "$1 $up $2" >/dev/ttyS1; }
mark up
for module in /modules/*; do
  case $module in
    *-vivid.ko) insmod "$module" n_devs=2 node_types=0x101,0x101 multiplanar=1,1 num_inputs=2,2 input_types=0xc,0xc num_outputs=1,1 output_types=1,1 \
      vid_cap_nr=0,1 vid_out_nr=2,3 no_error_inj=0 ;;
    *) insmod "$module" ;;
  esac
done
mark cameras
. /environment
sh /run
mark done $?
reboot -f
INIT
chmod +x "$root/init"
(cd "$root" && find . -print0 | cpio --null --create --format=newc --quiet) >"$work/image"
built=$(since "$started")

# The program's output is the first serial line, marks go to the second. No KVM: its flavours differ, and this has to work everywhere.
status=0
timeout --foreground "$seconds" qemu-system-x86_64 -nodefaults -no-user-config -no-reboot -display none -machine pc -accel tcg,thread=multi \
  -cpu max -smp 2 -m 1024 -kernel "$cache"/boot/vmlinuz-* -initrd "$work/image" \
  -append "console=ttyS0 quiet loglevel=3 panic=-1 mitigations=off nokaslr random.trust_cpu=on" \
  -serial stdio -serial "file:$work/marks" </dev/null | tr -d '\r' || status=$?
mark() { tr -d '\r' <"$work/marks" | awk -v name="$1" -v field="$2" '$1 == name { print $field }'; }
echo "vivid: kernel $version; ready after $fetched s, image after $built s, done after $(since "$started") s; in the guest up at $(mark up 2) s, cameras at" \
  "$(mark cameras 2) s, done at $(mark done 2) s" >&2
[ "$status" != 124 ] || { echo "vivid: gave up after $seconds s" >&2; exit 124; }
result=$(mark done 3)
exit "${result:-125}"
