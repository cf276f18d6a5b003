//! Messages of Foxglove's schemas, which Foxglove, Lichtblick and Rerun show as they are.

use nalgebra::{Isometry3, Point3};
use vergence_geometry::{Camera, Distortion};

use crate::proto::{self, Message, Value};

/// Name of the frame that stands still.
pub const BASE: &str = "base";
/// Names of the frames of the cameras: x right, y down, z forward, as Foxglove's own optical frames.
pub const CAMERAS: [&str; 2] = ["left_camera", "right_camera"];

/// How grave a line of the log is; the numbers are Foxglove's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Worth knowing.
    Info = 2,
    /// Something is not as it should be, and the run goes on.
    Warning = 3,
    /// Something failed.
    Error = 4,
}

fn stamp(message: &mut Message, number: u32, ns: u64) {
    message.message(number, |t| {
        t.varint(1, ns / 1_000_000_000)
            .varint(2, ns % 1_000_000_000);
    });
}

fn vector(message: &mut Message, number: u32, v: [f64; 3]) {
    message.message(number, |m| {
        m.double(1, v[0]).double(2, v[1]).double(3, v[2]);
    });
}

fn rotation(message: &mut Message, number: u32, pose: &Isometry3<f64>) {
    message.message(number, |m| {
        let q = pose.rotation.coords;
        m.double(1, q.x)
            .double(2, q.y)
            .double(3, q.z)
            .double(4, q.w);
    });
}

/// `foxglove.CompressedImage`.
pub fn compressed_image(ns: u64, frame: &str, format: &str, file: &[u8]) -> Vec<u8> {
    let mut message = Message::new();
    stamp(&mut message, 1, ns);
    message.bytes(2, file).string(3, format).string(4, frame);
    message.into_bytes()
}

/// The file and its format within a `foxglove.CompressedImage`; `None` when it is none.
pub fn image_in(bytes: &[u8]) -> Option<(&[u8], &str)> {
    let (mut file, mut format) = (None, "");
    for field in proto::fields(bytes) {
        let field = field.ok()?;
        match (field.number, field.value) {
            (2, Value::Bytes(bytes)) => file = Some(bytes),
            (3, value) => format = value.text()?,
            _ => {}
        }
    }
    Some((file?, format))
}

/// `foxglove.CameraCalibration`: K and distortion as OpenCV has them; R the identity, since the pictures are not rectified.
pub fn camera_calibration(ns: u64, frame: &str, camera: &Camera) -> Vec<u8> {
    let k = &camera.intrinsics;
    let model = match &camera.distortion {
        Distortion::BrownConrady(_) => "rational_polynomial",
        Distortion::KannalaBrandt(_) => "kannala_brandt",
    };
    let mut message = Message::new();
    stamp(&mut message, 1, ns);
    message
        .fixed32(2, k.width as u32)
        .fixed32(3, k.height as u32)
        .string(4, model)
        .doubles(5, &camera.distortion.coefficients())
        .doubles(6, &[k.fx, 0.0, k.cx, 0.0, k.fy, k.cy, 0.0, 0.0, 1.0])
        .doubles(7, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
        .doubles(
            8,
            &[
                k.fx, 0.0, k.cx, 0.0, 0.0, k.fy, k.cy, 0.0, 0.0, 0.0, 1.0, 0.0,
            ],
        )
        .string(9, frame);
    message.into_bytes()
}

/// `foxglove.FrameTransforms`: where frames stand in their parents.
pub fn frame_transforms(ns: u64, transforms: &[(&str, &str, Isometry3<f64>)]) -> Vec<u8> {
    let mut message = Message::new();
    for (parent, child, pose) in transforms {
        message.message(1, |t| {
            stamp(t, 1, ns);
            t.string(2, parent).string(3, child);
            vector(t, 4, pose.translation.vector.into());
            rotation(t, 5, pose);
        });
    }
    message.into_bytes()
}

/// `foxglove.PoseInFrame` of a point.
pub fn pose_in_frame(ns: u64, frame: &str, point: &Point3<f64>) -> Vec<u8> {
    let mut message = Message::new();
    stamp(&mut message, 1, ns);
    message.string(2, frame).message(3, |pose| {
        vector(pose, 1, point.coords.into());
        rotation(pose, 2, &Isometry3::identity());
    });
    message.into_bytes()
}

/// `foxglove.Log`.
pub fn log(ns: u64, level: Level, name: &str, text: &str) -> Vec<u8> {
    let mut message = Message::new();
    stamp(&mut message, 1, ns);
    message
        .varint(2, level as u64)
        .string(3, text)
        .string(4, name);
    message.into_bytes()
}
