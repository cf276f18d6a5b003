//! `vergence grade` on a folder of the test's own, with a model imported there: a toy that libsvm trained, whose scores mean nothing.
//! Pictures are dead leaves (overlapping discs), which have the statistics of natural scenes and belong to the project.

#![allow(dead_code, reason = "each test binary uses a part")]
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use vergence_imaging::Rgb;
use vergence_imaging::files::{read_rgb, write_rgb};

/// Files of the crate `quality`.
pub(crate) const QUALITY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../quality/tests");

/// A folder with a model.
pub(crate) struct Place {
    dir: tempfile::TempDir,
}

/// What came out.
#[derive(Debug)]
pub(crate) struct Done {
    pub(crate) code: i32,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl Place {
    pub(crate) fn new() -> Self {
        let place = Self {
            dir: tempfile::tempdir().unwrap(),
        };
        let model = format!("{QUALITY}/libsvm");
        let done = place.run(&["model", "import", &model, "--name", "toy"]);
        assert_eq!(done.code, 0, "{done:?}");
        place
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub(crate) fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_vergence"));
        for (name, _) in std::env::vars_os() {
            if name.to_string_lossy().starts_with("VERGENCE_") {
                command.env_remove(name);
            }
        }
        command
            .args(args)
            .current_dir(self.dir.path())
            .env("VERGENCE_DATA_DIR", self.path("data"));
        command
    }

    pub(crate) fn run(&self, args: &[&str]) -> Done {
        let output = self.command(args).output().unwrap();
        Done {
            code: output.status.code().unwrap(),
            out: String::from_utf8(output.stdout).unwrap(),
            err: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// `vergence grade --model toy ...`
    pub(crate) fn grade(&self, args: &[&str]) -> Done {
        self.run(&[&["grade", "--model", "toy"], args].concat())
    }

    /// The same with JSON, which must go well.
    pub(crate) fn json(&self, args: &[&str]) -> Value {
        let done = self.grade(&[args, &["--format", "json"]].concat());
        assert_eq!((done.code, done.err.as_str()), (0, ""), "{done:?}");
        serde_json::from_str(&done.out).unwrap()
    }

    /// Write a picture.
    pub(crate) fn picture(&self, name: &str, picture: &Rgb) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_rgb(&path, picture).unwrap();
        path
    }

    /// Write bytes.
    pub(crate) fn bytes(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

impl Done {
    /// The one sentence of a refusal.
    pub(crate) fn refused(&self, code: i32) -> &str {
        assert_eq!((self.code, self.out.as_str()), (code, ""), "{self:?}");
        assert!(self.err.starts_with("error: "), "{self:?}");
        assert!(!self.err.contains("panicked"), "{self:?}");
        &self.err
    }

    /// The lines of stdout as JSON.
    pub(crate) fn lines(&self) -> Vec<Value> {
        let lines = self.out.lines();
        lines
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    }
}

/// One of the dead-leaves pictures of the crate `quality`.
pub(crate) fn leaves(name: &str) -> PathBuf {
    Path::new(QUALITY).join("data").join(name)
}

/// Dead leaves of any size from a seed.
pub(crate) fn drawn_leaves(w: usize, h: usize, seed: u32) -> Rgb {
    let mut state = seed;
    let mut draw = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1_u32 << 24)
    };
    let mut picture = Rgb::filled(w, h, [128; 3]);
    for _ in 0..w * h / 20 {
        let radius = 2.5 / (1.0 - 0.98 * draw()).sqrt();
        let (x, y) = (draw() * w as f64, draw() * h as f64);
        let colour = [draw(), draw(), draw()].map(|c| (40.0 + 190.0 * c) as u8);
        let span = |at: f64, side: usize| {
            (at - radius).max(0.0) as usize..=((at + radius) as usize).min(side - 1)
        };
        for v in span(y, h) {
            for u in span(x, w) {
                if (u as f64 - x).hypot(v as f64 - y) <= radius {
                    picture.set(u, v, colour);
                }
            }
        }
    }
    picture
}

/// Left and right view of a scene in two depths: the middle of the picture stands `near` px in front, the rest `far` px behind the
/// screen; the left picture lies `down` px lower.
pub(crate) fn pair(w: usize, h: usize, near: usize, far: usize, down: usize) -> [Rgb; 2] {
    let wide = drawn_leaves(w + 80, h + 20, 7);
    let middle = drawn_leaves(w + 80, h + 20, 8);
    let view = |sign: isize, lower: usize| {
        Rgb::from_fn(w, h, |x, y| {
            let at = |shift: isize| (x as isize + 40 + shift) as usize;
            let v = y + 10 - lower;
            // In front: the left eye sees it further right. Shifts are split between the eyes.
            let front = at(-sign * near as isize / 2);
            let inside = (w * 2 / 5 + 40..w * 3 / 5 + 40).contains(&front)
                && (h / 4..h * 3 / 4).contains(&v);
            if inside {
                middle.at(front, v)
            } else {
                wide.at(at(sign * far as isize / 2), v)
            }
        })
    };
    [view(1, down), view(-1, 0)]
}

/// Two pictures beside each other.
pub(crate) fn beside([a, b]: [&Rgb; 2]) -> Rgb {
    let (w, h) = a.size();
    Rgb::from_fn(
        2 * w,
        h,
        |x, y| if x < w { a.at(x, y) } else { b.at(x - w, y) },
    )
}

/// A picture as a JPEG file in memory.
pub(crate) fn jpeg(place: &Place, picture: &Rgb) -> Vec<u8> {
    let path = place.picture("for_its_bytes.jpg", picture);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::remove_file(path).unwrap();
    bytes
}

/// A segment after the start of a JPEG file.
pub(crate) fn with_segment(mut jpeg: Vec<u8>, mark: u8, body: &[u8]) -> Vec<u8> {
    let mut segment = vec![0xff, mark];
    segment.extend((body.len() as u16 + 2).to_be_bytes());
    segment.extend(body);
    jpeg.splice(2..2, segment);
    jpeg
}

/// An MPO file after CIPA DC-007: two views with their numbers, big-endian.
pub(crate) fn mpo(pictures: [Vec<u8>; 2], numbers: [u32; 2]) -> Vec<u8> {
    let entry = |tag: u16, kind: u16, count: u32, value: u32| {
        [
            &tag.to_be_bytes()[..],
            &kind.to_be_bytes(),
            &count.to_be_bytes(),
            &value.to_be_bytes(),
        ]
        .concat()
    };
    let number = |n: u32| [&[0, 1][..], &entry(0xb101, 4, 1, n), &[0; 4]].concat();
    let start = b"MPF\0MM\0*\0\0\0\x08".as_slice();
    let [first, second] = pictures;
    let second = with_segment(second, 0xe2, &[start, &number(numbers[1])].concat());
    let of_sizes = |own: u32, other_at: u32| {
        let words = [
            0x0002_0002,
            own,
            0,
            0,
            0x0002_0002,
            second.len() as u32,
            other_at,
            0,
        ];
        let list: Vec<u8> = words.into_iter().flat_map(u32::to_be_bytes).collect();
        let index = [
            &[0, 1][..],
            &entry(0xb002, 7, 32, 44),
            &26_u32.to_be_bytes(),
        ]
        .concat();
        with_segment(
            first.clone(),
            0xe2,
            &[start, &index, &number(numbers[0]), &list].concat(),
        )
    };
    let length = of_sizes(0, 0).len() as u32;
    [of_sizes(length, length - 10), second].concat()
}

/// A file of the shared folder; `None`, with a message, where it is not there.
pub(crate) fn shared(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let path = root.join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: no {} (set VERGENCE_TEST_DATA)", path.display());
    None
}

/// A number by its place in JSON.
pub(crate) fn number(value: &Value, place: &str) -> f64 {
    let found = value.pointer(place).and_then(Value::as_f64);
    found.unwrap_or_else(|| panic!("no number at {place} in {value}"))
}

/// A picture from a file, for changing it.
pub(crate) fn read(path: &Path) -> Rgb {
    read_rgb(path).unwrap()
}

/// Paths of all fields of a JSON value, those of list entries under the list's name.
pub(crate) fn fields(value: &Value, path: &str, found: &mut Vec<String>) {
    match value {
        Value::Object(entries) => {
            for (name, inner) in entries {
                // Names of fields that are null are data here.
                if path == "not_judged" {
                    continue;
                }
                let inner_path = if path.is_empty() {
                    name.clone()
                } else {
                    format!("{path}.{name}")
                };
                found.push(inner_path.clone());
                fields(inner, &inner_path, found);
            }
        }
        Value::Array(entries) => entries.iter().for_each(|inner| fields(inner, path, found)),
        _ => {}
    }
}
