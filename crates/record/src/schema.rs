//! What the messages are: descriptors of protocol buffers, built from tables.
//!
//! A schema of a recording is a serialized `google.protobuf.FileDescriptorSet` of the message and all that it is made of, so that any
//! program can read the messages without knowing ours. Field numbers of `foxglove.*` are those of Foxglove's published schemas.

use crate::proto::Message;

/// Type of a field; the numbers are those of `FieldDescriptorProto.Type`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Type {
    Double,
    Int64,
    Int32,
    Uint64,
    Fixed32,
    Bool,
    String,
    Bytes,
    /// A message by its full name.
    Message(&'static str),
    /// An enum by its full name.
    Enum(&'static str),
}

impl Type {
    fn number(self) -> u64 {
        match self {
            Type::Double => 1,
            Type::Int64 => 3,
            Type::Uint64 => 4,
            Type::Int32 => 5,
            Type::Fixed32 => 7,
            Type::Bool => 8,
            Type::String => 9,
            Type::Message(_) => 11,
            Type::Bytes => 12,
            Type::Enum(_) => 14,
        }
    }
}

/// How often a field is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Label {
    /// Once; left out when it is at its default.
    One,
    /// Once or not at all, and one can tell.
    Optional,
    /// Any number of times.
    Repeated,
}

/// A field of a message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FieldOf {
    pub(crate) name: &'static str,
    pub(crate) number: u32,
    pub(crate) kind: Type,
    pub(crate) label: Label,
}

/// A message with its package, "foxglove" "Pose".
struct Described {
    package: &'static str,
    name: &'static str,
    fields: &'static [FieldOf],
    /// An enum within it: its name and its values from 0.
    inner: Option<(&'static str, &'static [&'static str])>,
}

const fn one(name: &'static str, number: u32, kind: Type) -> FieldOf {
    FieldOf {
        name,
        number,
        kind,
        label: Label::One,
    }
}

const fn many(name: &'static str, number: u32, kind: Type) -> FieldOf {
    FieldOf {
        name,
        number,
        kind,
        label: Label::Repeated,
    }
}

const STAMP: Type = Type::Message("google.protobuf.Timestamp");

const fn foxglove(name: &'static str, fields: &'static [FieldOf]) -> Described {
    Described {
        package: "foxglove",
        name,
        fields,
        inner: None,
    }
}

/// All messages that are not ours, what they are made of before them.
const OTHERS: &[Described] = &[
    Described {
        package: "google.protobuf",
        name: "Timestamp",
        fields: &[one("seconds", 1, Type::Int64), one("nanos", 2, Type::Int32)],
        inner: None,
    },
    foxglove(
        "Vector3",
        &[
            one("x", 1, Type::Double),
            one("y", 2, Type::Double),
            one("z", 3, Type::Double),
        ],
    ),
    foxglove(
        "Quaternion",
        &[
            one("x", 1, Type::Double),
            one("y", 2, Type::Double),
            one("z", 3, Type::Double),
            one("w", 4, Type::Double),
        ],
    ),
    foxglove(
        "Pose",
        &[
            one("position", 1, Type::Message("foxglove.Vector3")),
            one("orientation", 2, Type::Message("foxglove.Quaternion")),
        ],
    ),
    foxglove(
        "PoseInFrame",
        &[
            one("timestamp", 1, STAMP),
            one("frame_id", 2, Type::String),
            one("pose", 3, Type::Message("foxglove.Pose")),
        ],
    ),
    foxglove(
        "FrameTransform",
        &[
            one("timestamp", 1, STAMP),
            one("parent_frame_id", 2, Type::String),
            one("child_frame_id", 3, Type::String),
            one("translation", 4, Type::Message("foxglove.Vector3")),
            one("rotation", 5, Type::Message("foxglove.Quaternion")),
        ],
    ),
    foxglove(
        "FrameTransforms",
        &[many(
            "transforms",
            1,
            Type::Message("foxglove.FrameTransform"),
        )],
    ),
    foxglove(
        "CompressedImage",
        &[
            one("timestamp", 1, STAMP),
            one("data", 2, Type::Bytes),
            one("format", 3, Type::String),
            one("frame_id", 4, Type::String),
        ],
    ),
    foxglove(
        "CameraCalibration",
        &[
            one("timestamp", 1, STAMP),
            one("width", 2, Type::Fixed32),
            one("height", 3, Type::Fixed32),
            one("distortion_model", 4, Type::String),
            many("D", 5, Type::Double),
            many("K", 6, Type::Double),
            many("R", 7, Type::Double),
            many("P", 8, Type::Double),
            one("frame_id", 9, Type::String),
        ],
    ),
    Described {
        package: "foxglove",
        name: "Log",
        fields: &[
            one("timestamp", 1, STAMP),
            one("level", 2, Type::Enum("foxglove.Log.Level")),
            one("message", 3, Type::String),
            one("name", 4, Type::String),
            one("file", 5, Type::String),
            one("line", 6, Type::Fixed32),
        ],
        inner: Some((
            "Level",
            &["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"],
        )),
    },
];

/// The descriptor of one of the messages that are not ours, by its full name.
pub(crate) fn descriptor_of(full: &str) -> Vec<u8> {
    let mut set = Message::new();
    let mut done = Vec::new();
    add_file(&mut set, full, &mut done);
    set.into_bytes()
}

/// The descriptor of a message of ours that is made of plain fields only.
pub(crate) fn descriptor_of_flat(name: &str, fields: &[FieldOf]) -> Vec<u8> {
    let mut set = Message::new();
    set.message(1, |file| {
        write_file(file, "vergence", name, fields, None, &[]);
    });
    set.into_bytes()
}

/// Add the file of `full` after the files that it needs.
fn add_file(set: &mut Message, full: &str, done: &mut Vec<String>) {
    if done.iter().any(|name| name == full) {
        return;
    }
    let Some(described) = OTHERS
        .iter()
        .find(|d| full == format!("{}.{}", d.package, d.name))
    else {
        debug_assert!(false, "no message {full}");
        return;
    };
    let mut needs: Vec<&str> = Vec::new();
    for field in described.fields {
        if let Type::Message(name) = field.kind
            && !needs.contains(&name)
        {
            needs.push(name);
        }
    }
    for need in &needs {
        add_file(set, need, done);
    }
    done.push(full.to_owned());
    set.message(1, |file| {
        let Described {
            package,
            name,
            fields,
            inner,
        } = described;
        write_file(file, package, name, fields, *inner, &needs);
    });
}

/// A `FileDescriptorProto` with one message.
fn write_file(
    file: &mut Message,
    package: &str,
    name: &str,
    fields: &[FieldOf],
    inner: Option<(&str, &[&str])>,
    needs: &[&str],
) {
    file.string(1, &file_name(&format!("{package}.{name}")));
    file.string(2, package);
    for need in needs {
        file.string(3, &file_name(need));
    }
    file.message(4, |message| {
        message.string(1, name);
        let mut optional = Vec::new();
        for field in fields {
            message.message(2, |f| {
                write_field(f, field, optional.len() as u64);
            });
            if field.label == Label::Optional {
                optional.push(field.name);
            }
        }
        if let Some((name, values)) = inner {
            message.message(4, |e| {
                e.string(1, name);
                for (number, value) in values.iter().enumerate() {
                    e.message(2, |v| {
                        v.string(1, value);
                        v.present().varint(2, number as u64);
                    });
                }
            });
        }
        // What proto3 calls optional is a choice of one.
        for name in optional {
            message.message(8, |o| {
                o.string(1, &format!("_{name}"));
            });
        }
    });
    file.string(12, "proto3");
}

fn write_field(f: &mut Message, field: &FieldOf, choice: u64) {
    f.string(1, field.name);
    f.varint(3, u64::from(field.number));
    f.varint(4, if field.label == Label::Repeated { 3 } else { 1 });
    f.varint(5, field.kind.number());
    if let Type::Message(name) | Type::Enum(name) = field.kind {
        f.string(6, &format!(".{name}"));
    }
    if field.label == Label::Optional {
        f.present().varint(9, choice);
    }
    f.string(10, &json_name(field.name));
    if field.label == Label::Optional {
        f.varint(17, 1);
    }
}

/// Where a message would be declared: Google's and Foxglove's files keep their names.
fn file_name(full: &str) -> String {
    match full {
        "google.protobuf.Timestamp" => "google/protobuf/timestamp.proto".to_owned(),
        other => format!("{}.proto", other.replace('.', "/")),
    }
}

/// `left_capture_s` is `leftCaptureS` in JSON.
fn json_name(name: &str) -> String {
    let mut out = String::new();
    let mut upper = false;
    for c in name.chars() {
        if c == '_' {
            upper = true;
        } else if std::mem::take(&mut upper) {
            out.extend(c.to_uppercase());
        } else {
            out.push(c);
        }
    }
    out
}
