//! Numbered pictures in a folder.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use vergence_imaging::{Rgb, files};

use crate::CaptureError;
use crate::files::OnFault;
use crate::files::stream::{Decoder, EyeStream, Timed};

/// Most files of one folder that are looked at.
const MAX_FILES: usize = 1_000_000;

/// Largest number that is taken for a frame's index; larger ones are time stamps or serial numbers.
const MAX_INDEX: u64 = 1_000_000_000;

/// How many indexes an error lists before it only counts them.
const LISTED: usize = 8;

/// The pictures of one eye by frame index.
#[derive(Debug)]
pub(crate) struct PictureList {
    pub(crate) fps: f64,
    on_unreadable: OnFault,
    named: PathBuf,
    pictures: BTreeMap<u64, PathBuf>,
}

impl PictureList {
    /// The pictures that a folder, a pattern or the name of one picture stands for; `None` for anything else, which may
    /// be a video.
    pub(crate) fn find(
        named: &Path,
        fps: f64,
        on_unreadable: OnFault,
    ) -> Result<Option<Self>, CaptureError> {
        let refuse = |reason: &str| {
            Err(CaptureError::Input {
                reason: reason.to_owned(),
                path: named.to_owned(),
            })
        };
        if named.to_str().is_some_and(|s| s.contains("://")) {
            return Ok(None);
        }
        let pattern = named
            .file_name()
            .and_then(|n| n.to_str())
            .filter(|n| n.contains('*'));
        let files = if named.is_dir() {
            pictures_in(named, |_| true)?
        } else if named.is_file() {
            if !is_picture(named) {
                return Ok(None);
            }
            vec![named.to_owned()]
        } else if let Some(pattern) = pattern {
            let folder = match named.parent() {
                Some(p) if !p.as_os_str().is_empty() => p,
                _ => Path::new("."),
            };
            pictures_in(folder, |name| matches_pattern(pattern, name))?
        } else {
            return refuse("there is no such file or folder");
        };
        if files.is_empty() {
            return refuse(match pattern {
                Some(_) => "no picture (.png, .jpg, .jpeg) has a name like this",
                None => "the folder holds no pictures (.png, .jpg, .jpeg)",
            });
        }
        Ok(Some(Self {
            fps,
            on_unreadable,
            named: named.to_owned(),
            pictures: by_index(files, named)?,
        }))
    }

    /// Whether it is one picture that was named itself.
    pub(crate) fn is_single(&self) -> bool {
        self.named.is_file()
    }

    /// Give a single picture the index 0, whatever number its name holds.
    pub(crate) fn count_from_zero(&mut self) {
        self.pictures = (0..)
            .zip(std::mem::take(&mut self.pictures).into_values())
            .collect();
    }

    /// Keep the indexes that both lists have, and say how many they are.
    ///
    /// # Errors
    /// With [`OnFault::Refuse`] when there are others; in any case when there is none in common.
    pub(crate) fn match_with(
        &mut self,
        right: &mut Self,
        on_unpaired: OnFault,
    ) -> Result<usize, CaptureError> {
        let without = |a: &Self, b: &Self| -> Vec<u64> {
            let alone = a.pictures.keys().filter(|k| !b.pictures.contains_key(k));
            alone.copied().collect()
        };
        let left_alone = without(self, right);
        let right_alone = without(right, self);
        let common = self.pictures.len() - left_alone.len();
        let faulty = !(left_alone.is_empty() && right_alone.is_empty());
        if (faulty && on_unpaired == OnFault::Refuse) || common == 0 {
            let mut message = format!(
                "{} left and {} right pictures",
                self.pictures.len(),
                right.pictures.len()
            );
            for (alone, other) in [(&left_alone, "right"), (&right_alone, "left")] {
                if !alone.is_empty() {
                    message += &format!("; no {other} picture for {}", indexes(alone));
                }
            }
            return Err(CaptureError::Unequal(message));
        }
        Ok(common)
    }

    /// Check the headers and start decoding.
    pub(crate) fn open(self) -> Result<EyeStream, CaptureError> {
        let mut size: Option<((usize, usize), &Path)> = None;
        for path in self.pictures.values() {
            let found = match files::read_size(path) {
                Ok(found) => found,
                Err(_) if self.on_unreadable == OnFault::Skip => continue,
                Err(e) => return Err(e.into()),
            };
            let (expected, reference) = *size.get_or_insert((found, path));
            check_size(found, expected, reference, path)?;
        }
        let Some((size, reference)) = size.map(|(s, p)| (s, p.to_owned())) else {
            return Err(CaptureError::Input {
                reason: format!("none of its {} pictures can be read", self.pictures.len()),
                path: self.named,
            });
        };
        let decoder = PictureDecoder {
            fps: self.fps,
            on_unreadable: self.on_unreadable,
            size,
            reference: reference.clone(),
            pictures: self.pictures.into_iter(),
        };
        EyeStream::of_pictures(decoder, size, reference)
    }
}

/// Reads the pictures of a list one after the other.
struct PictureDecoder {
    fps: f64,
    on_unreadable: OnFault,
    size: (usize, usize),
    reference: PathBuf,
    pictures: std::collections::btree_map::IntoIter<u64, PathBuf>,
}

impl Decoder for PictureDecoder {
    fn next(&mut self, _reuse: Option<Rgb>) -> Result<Option<Timed>, CaptureError> {
        let Some((index, path)) = self.pictures.next() else {
            return Ok(None);
        };
        let picture = match files::read_rgb(&path) {
            Ok(picture) => {
                check_size(picture.size(), self.size, &self.reference, &path)?;
                Some(picture)
            }
            Err(_) if self.on_unreadable == OnFault::Skip => None,
            Err(e) => return Err(e.into()),
        };
        Ok(Some(Timed {
            time_s: index as f64 / self.fps,
            picture,
        }))
    }
}

fn check_size(
    found: (usize, usize),
    expected: (usize, usize),
    reference: &Path,
    path: &Path,
) -> Result<(), CaptureError> {
    if found == expected {
        return Ok(());
    }
    Err(CaptureError::PictureSize {
        found,
        expected,
        reference: reference.to_owned(),
        path: path.to_owned(),
    })
}

fn is_picture(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    ["png", "jpg", "jpeg"]
        .iter()
        .any(|e| extension.eq_ignore_ascii_case(e))
}

fn pictures_in(folder: &Path, wanted: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>, CaptureError> {
    let io = |source| CaptureError::Io {
        action: "listing a folder",
        source,
        path: folder.to_owned(),
    };
    let mut found = Vec::new();
    for (seen, entry) in std::fs::read_dir(folder).map_err(io)?.enumerate() {
        if seen >= MAX_FILES {
            return Err(CaptureError::Input {
                reason: format!("the folder holds more than {MAX_FILES} files"),
                path: folder.to_owned(),
            });
        }
        let path = entry.map_err(io)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if is_picture(&path) && wanted(&name) && path.is_file() {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Whether `name` is the pattern with every `*` replaced by some text, possibly none.
fn matches_pattern(pattern: &str, name: &str) -> bool {
    let Some((head, rest)) = pattern.split_once('*') else {
        return pattern == name;
    };
    let Some(mut name) = name.strip_prefix(head) else {
        return false;
    };
    let mut parts: Vec<&str> = rest.split('*').collect();
    let tail = parts.pop().unwrap_or("");
    // Taking each middle part where it first occurs leaves most room for those after it.
    for part in parts {
        let Some(at) = name.find(part) else {
            return false;
        };
        name = &name[at + part.len()..];
    }
    name.ends_with(tail)
}

/// The pictures by the last number in their names, or counted in order of name where no name holds a number.
fn by_index(files: Vec<PathBuf>, named: &Path) -> Result<BTreeMap<u64, PathBuf>, CaptureError> {
    let numbers: Vec<Option<u64>> = files
        .iter()
        .map(|f| last_number(f))
        .collect::<Result<_, _>>()?;
    if numbers.iter().all(Option::is_none) {
        return Ok((0..).zip(files).collect());
    }
    let mut pictures = BTreeMap::new();
    for (file, number) in files.into_iter().zip(numbers) {
        let Some(number) = number else {
            return Err(CaptureError::Input {
                reason: format!(
                    "some pictures have a number in their name and this one has none (in {})",
                    named.display()
                ),
                path: file,
            });
        };
        if let Some(other) = pictures.insert(number, file.clone()) {
            return Err(CaptureError::Input {
                reason: format!(
                    "two pictures have the number {number}, the other one is {}",
                    other.display()
                ),
                path: file,
            });
        }
    }
    Ok(pictures)
}

/// The last run of digits in a file's name without its extension.
fn last_number(path: &Path) -> Result<Option<u64>, CaptureError> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let Some(digits) = stem
        .split(|c: char| !c.is_ascii_digit())
        .rfind(|run| !run.is_empty())
    else {
        return Ok(None);
    };
    match digits.parse() {
        Ok(number) if number <= MAX_INDEX => Ok(Some(number)),
        _ => Err(CaptureError::Input {
            reason: format!(
                "the number {digits} in the name is too large for a frame's index (at most {MAX_INDEX})"
            ),
            path: path.to_owned(),
        }),
    }
}

/// "index 3" or "indexes 3, 4, 5 and 12 more".
fn indexes(alone: &[u64]) -> String {
    let listed: Vec<String> = alone.iter().take(LISTED).map(u64::to_string).collect();
    let word = if alone.len() == 1 { "index" } else { "indexes" };
    let mut text = format!("{word} {}", listed.join(", "));
    if alone.len() > LISTED {
        text += &format!(" and {} more", alone.len() - LISTED);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A star stands for any text, also none; everything else stands for itself.
    #[test]
    fn patterns_match_like_a_shell_does() {
        for (pattern, name, expected) in [
            ("left_*.jpg", "left_0036.jpg", true),
            ("left_*.jpg", "left_.jpg", true),
            ("left_*.jpg", "right_0036.jpg", false),
            ("left_*.jpg", "left_0036.png", false),
            ("*", "anything.png", true),
            ("*_l_*", "a_l_b_l_", true),
            ("a*b*c", "abc", true),
            ("a*b*c", "acb", false),
            ("ab*ba", "aba", false),
            ("**.png", "x.png", true),
            ("a*a", "a", false),
        ] {
            assert_eq!(matches_pattern(pattern, name), expected, "{pattern} {name}");
        }
    }

    /// The index is the last number of the name, not of the extension; absurd ones are refused.
    #[test]
    fn last_number_of_a_name() {
        let number = |name: &str| last_number(Path::new(name)).unwrap();
        assert_eq!(number("left_0036.jpg"), Some(36));
        assert_eq!(number("cam2_run10_7_left.png"), Some(7));
        assert_eq!(number("picture.jp2"), None);
        assert_eq!(number("frame12.3.png"), Some(3));
        assert!(last_number(Path::new("1403636579763555584.png")).is_err());
    }
}
