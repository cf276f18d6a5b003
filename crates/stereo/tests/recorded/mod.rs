//! Recorded pairs for tests: the folder in `VERGENCE_TEST_DATA`, or `../shared` beside the repository.

use std::path::{Path, PathBuf};

use vergence_imaging::Rgb;
use vergence_imaging::files::shown_from_bytes;

/// A recorded pair with its name.
pub(crate) struct RealPair {
    pub(crate) name: String,
    pub(crate) folder: PathBuf,
    pub(crate) left: Rgb,
    pub(crate) right: Rgb,
}

impl RealPair {
    pub(crate) fn pair(&self) -> [&Rgb; 2] {
        [&self.left, &self.right]
    }
}

/// Where the recordings are, or a plain word that the test was skipped.
pub(crate) fn data_folder(test: &str) -> Option<PathBuf> {
    let folder = match std::env::var_os("VERGENCE_TEST_DATA") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
    };
    let found = folder.join("stereo/disparity").is_dir();
    if !found {
        eprintln!("{test}: SKIPPED, no recordings in {}", folder.display());
    }
    found.then_some(folder)
}

/// The rectified pairs.
pub(crate) fn disparity_pairs(data: &Path) -> Vec<RealPair> {
    let mut pairs = Vec::new();
    for folder in sorted(&data.join("stereo/disparity")) {
        let picture = |name: &str| {
            ["png", "jpg"]
                .map(|ext| folder.join(format!("{name}.{ext}")))
                .into_iter()
                .find(|path| path.is_file())
        };
        if let (Some(left), Some(right)) = (picture("left"), picture("right")) {
            pairs.push(RealPair {
                name: folder.file_name().unwrap().to_string_lossy().into_owned(),
                left: read(&std::fs::read(left).unwrap()),
                right: read(&std::fs::read(right).unwrap()),
                folder,
            });
        }
    }
    pairs
}

/// The stereo photographs: side by side, or two JPEGs in one file.
pub(crate) fn photographs(data: &Path) -> Vec<RealPair> {
    let mut pairs = Vec::new();
    for path in sorted(&data.join("stereo/sbs")) {
        let bytes = std::fs::read(&path).unwrap();
        let name = path.file_stem().unwrap().to_string_lossy().into_owned();
        let (left, right) = if path.extension().is_some_and(|e| e == "mpo") {
            let second = second_jpeg(&bytes);
            (read(&bytes[..second]), read(&bytes[second..]))
        } else {
            let both = read(&bytes);
            let half = both.width() / 2;
            let eye = |from: usize| Rgb::from_fn(half, both.height(), |x, y| both.at(from + x, y));
            (eye(0), eye(half))
        };
        pairs.push(RealPair {
            name,
            folder: path,
            left,
            right,
        });
    }
    pairs
}

pub(crate) fn read(bytes: &[u8]) -> Rgb {
    let shown = shown_from_bytes(bytes, Path::new("a recorded picture"));
    shown.unwrap().picture
}

/// The second picture of a multi-picture file: the start of image nearest the file's middle that decodes to the first one's size.
fn second_jpeg(bytes: &[u8]) -> usize {
    let size =
        |from: usize| shown_from_bytes(&bytes[from..], Path::new("")).map(|p| p.picture.size());
    let first = size(0).unwrap();
    let middle = bytes.len() / 2;
    let mut starts: Vec<usize> = (2..bytes.len() - 4)
        .filter(|&at| bytes[at..].starts_with(&[0xff, 0xd8, 0xff]) && bytes[at + 3] >= 0xe0)
        .collect();
    starts.sort_by_key(|at| at.abs_diff(middle));
    starts
        .into_iter()
        .find(|&at| size(at).is_ok_and(|s| s == first))
        .unwrap()
}

fn sorted(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths
}
