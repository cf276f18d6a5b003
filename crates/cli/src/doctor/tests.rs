//! Proves: cameras and ports are told from the kernel's files as they lie in /sys and /dev, also when there is nothing or nonsense; what a camera answers stands
//! behind its name.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

use vergence_capture::CaptureError;
use vergence_capture::live::FormatOffer;

use super::*;

/// Asks no device anything.
fn nothing(_: &Path) -> Option<Result<Abilities, CaptureError>> {
    None
}

fn places(root: &Path) -> Places {
    Places {
        dev: root.join("dev"),
        sys: root.join("sys"),
    }
}

/// A camera with two nodes on one USB device, as uvcvideo makes them.
fn camera(root: &Path, device: &str, nodes: [&str; 2], name: &str, speed: &str) {
    let usb = root.join("sys/devices").join(device);
    let interface = usb.join("1-1:1.0");
    fs::create_dir_all(&interface).unwrap();
    fs::write(usb.join("speed"), speed).unwrap();
    fs::create_dir_all(root.join("sys/bus/usb/drivers/uvcvideo")).unwrap();
    symlink(
        root.join("sys/bus/usb/drivers/uvcvideo"),
        interface.join("driver"),
    )
    .unwrap();
    for node in nodes {
        let class = root.join("sys/class/video4linux").join(node);
        fs::create_dir_all(&class).unwrap();
        fs::write(class.join("name"), format!("{name}\n")).unwrap();
        symlink(&interface, class.join("device")).unwrap();
        fs::create_dir_all(root.join("dev")).unwrap();
        fs::write(root.join("dev").join(node), "").unwrap();
    }
}

#[test]
fn nothing_is_a_note_with_a_remedy() {
    let dir = tempfile::tempdir().unwrap();
    let places = places(dir.path());
    let all = [
        cameras::checks(&places, &nothing),
        serial::checks(&serial::ports(&places)),
    ]
    .concat();
    assert_eq!(all.len(), 2);
    for check in all {
        assert_eq!(check.status, Status::Note, "{check:?}");
        assert!(check.next.is_some(), "{check:?}");
    }
}

#[test]
fn cameras_are_told_by_their_device() {
    let dir = tempfile::tempdir().unwrap();
    camera(
        dir.path(),
        "1-1",
        ["video0", "video1"],
        "HD Camera: left",
        "480",
    );
    let one = cameras::checks(&places(dir.path()), &nothing);
    assert_eq!(one.len(), 1, "{one:?}");
    assert_eq!(
        one[0].found,
        "HD Camera: left, driver uvcvideo, USB at 480 Mbit/s, also video1"
    );
    assert_eq!(one[0].status, Status::Good);
    let further = cameras::further(&one);
    assert_eq!(further[0].status, Status::Note);
    assert_eq!(further[0].found, "one camera is no pair");
    camera(dir.path(), "1-2", ["video10", "video2"], "slow\u{7}", "12");
    let two = cameras::checks(&places(dir.path()), &nothing);
    assert_eq!(two.len(), 2, "{two:?}");
    assert!(
        two[1].item.ends_with("video2") && two[1].status == Status::Wrong,
        "{two:?}"
    );
    assert_eq!(
        two[1].found,
        "slow, driver uvcvideo, USB at 12 Mbit/s, also video10"
    );
}

/// The first node that answers as a camera is believed; a device of which none does is a note with the reason.
#[test]
fn cameras_say_what_they_can_do() {
    let dir = tempfile::tempdir().unwrap();
    camera(dir.path(), "1-1", ["video0", "video1"], "HD", "480");
    let places = places(dir.path());
    let refuse = |path: &Path| CaptureError::Camera {
        camera: path.display().to_string(),
        what: "cannot be used".to_owned(),
        why: "it is no camera".to_owned(),
    };
    let second = |path: &Path| {
        Some(match path.ends_with("video1") {
            true => Ok(Abilities {
                formats: vec![FormatOffer {
                    name: "YUYV".to_owned(),
                    is_read: true,
                    sizes: Vec::new(),
                }],
                ..Abilities::default()
            }),
            false => Err(refuse(path)),
        })
    };
    let found = cameras::checks(&places, &second);
    assert_eq!(found[0].status, Status::Good);
    assert!(
        found[0].found.ends_with("also video1; sends YUYV"),
        "{found:?}"
    );
    let none = cameras::checks(&places, &|path| Some(Err(refuse(path))));
    assert_eq!(none[0].status, Status::Note);
    assert!(none[0].next.is_some(), "{none:?}");
    let why = format!(
        "; {}/dev/video0 cannot be used: it is no camera",
        dir.path().display()
    );
    assert!(none[0].found.ends_with(&why), "{none:?}");
}

/// Without video devices in the program it is said how to get them; with them, how two cameras are looked at.
#[test]
fn what_more_can_be_asked() {
    let good = |item| Check::new("cameras", item, Status::Good, "a camera");
    assert_eq!(cameras::further(&[]), []);
    assert_eq!(
        cameras::further(&[Check {
            status: Status::Note,
            ..good(cameras::NONE)
        }]),
        []
    );
    let further = cameras::further(&[good("/dev/video0"), good("/dev/video2")]);
    assert_eq!(further.len(), 1, "{further:?}");
    let next = further[0].next.as_deref().unwrap();
    match reads_devices() {
        true => {
            let call = "vergence doctor --source v4l2 --left /dev/video0 --right /dev/video2";
            assert!(next.contains(call), "{next}");
        }
        false => assert_eq!(next, "build it with --features v4l2"),
    }
}

#[test]
fn ports_are_told_by_what_hangs_on_them() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    fs::create_dir_all(root.join("dev/serial/by-id")).unwrap();
    for port in ["ttyUSB10", "ttyUSB2", "ttyS0"] {
        fs::write(root.join("dev").join(port), "").unwrap();
    }
    symlink(
        "../../ttyUSB2",
        root.join("dev/serial/by-id/usb-Adapter-if00"),
    )
    .unwrap();
    let usb = root.join("sys/devices/1-3");
    fs::create_dir_all(usb.join("1-3:1.0/ttyUSB2")).unwrap();
    fs::write(usb.join("product"), "Motion board").unwrap();
    fs::create_dir_all(root.join("sys/class/tty/ttyUSB2")).unwrap();
    symlink(
        usb.join("1-3:1.0/ttyUSB2"),
        root.join("sys/class/tty/ttyUSB2/device"),
    )
    .unwrap();
    let checks = serial::checks(&serial::ports(&places(root)));
    assert_eq!(checks.len(), 2, "{checks:?}");
    assert!(checks[0].item.ends_with("ttyUSB2"));
    assert!(
        checks[0].found.starts_with("Motion board, always at "),
        "{checks:?}"
    );
    assert_eq!(checks[1].found, "unnamed");
}

#[test]
fn text_names_what_to_do() {
    let checks = [
        Check::new("cameras", "/dev/video0", Status::Good, "a camera"),
        Check::new("disk", "runs", Status::Wrong, "full").next("free some room"),
    ];
    let expected = "cameras\n  ok     /dev/video0: a camera\ndisk\n  WRONG  runs: full\n         -> free some room\n1 thing is wrong\n";
    assert_eq!(text_of(&checks, 1), expected);
}
