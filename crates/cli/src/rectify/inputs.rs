//! From what was typed to pairs of files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use vergence_geometry::Eye;
use vergence_imaging::files;

use crate::fault::{self, Fault};
use crate::grade::names;

/// A left and a right picture, and the names (without ending) of their results.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pair {
    pub(super) files: [PathBuf; 2],
    pub(super) stems: [String; 2],
}

/// The pairs of two lists of files, or of two folders.
pub(super) fn pairs(left: &[PathBuf], right: &[PathBuf]) -> Result<Vec<Pair>, Fault> {
    let matched = match (left, right) {
        ([left], [right]) if left.is_dir() && right.is_dir() => folders(left, right)?,
        _ => lists(left, right)?,
    };
    let mut taken: [BTreeMap<String, PathBuf>; 2] = Default::default();
    let mut pairs = Vec::new();
    for files in matched {
        if files[0] == files[1] {
            return Err(fault::usage(format!(
                "one picture is given for both eyes: {}",
                files[0].display()
            )));
        }
        let stems = files.each_ref().map(|file| {
            let stem = file.file_stem().unwrap_or_default();
            stem.to_string_lossy().into_owned()
        });
        for (i, taken) in taken.iter_mut().enumerate() {
            if let Some(other) = taken.insert(stems[i].clone(), files[i].clone()) {
                return Err(fault::usage(format!(
                    "two pictures would have the result {}.png: {} and {}",
                    stems[i],
                    other.display(),
                    files[i].display()
                ))
                .hint("rectify them in two calls, or rename one"));
            }
        }
        pairs.push(Pair { files, stems });
    }
    Ok(pairs)
}

/// The one size of all left pictures, and that of all right ones.
pub(super) fn sizes(pairs: &[Pair]) -> Result<[(usize, usize); 2], Fault> {
    let size_of = |file: &Path| files::read_size(file).map_err(|e| fault::usage(e.to_string()));
    let mut sizes = [(0, 0); 2];
    for (i, size) in sizes.iter_mut().enumerate() {
        let first = &pairs[0].files[i];
        *size = size_of(first)?;
        for pair in &pairs[1..] {
            let other = size_of(&pair.files[i])?;
            if other != *size {
                return Err(fault::usage(format!(
                    "the {} pictures differ in size: {} is {}x{}, {} is {}x{}",
                    ["left", "right"][i],
                    first.display(),
                    size.0,
                    size.1,
                    pair.files[i].display(),
                    other.0,
                    other.1
                ))
                .hint("one calibration fits pictures of one size; rectify the others in a call of their own"));
            }
        }
    }
    Ok(sizes)
}

fn lists(left: &[PathBuf], right: &[PathBuf]) -> Result<Vec<[PathBuf; 2]>, Fault> {
    for file in left.iter().chain(right) {
        if file.is_dir() {
            return Err(fault::usage(format!(
                "a folder stands among pictures: {}",
                file.display()
            ))
            .hint("name one folder for each eye, or files for both"));
        }
        if !file.exists() {
            return Err(fault::usage(format!(
                "there is no such file: {}",
                file.display()
            )));
        }
    }
    if left.len() != right.len() {
        return Err(fault::usage(format!(
            "{} left and {} right pictures: each needs its partner",
            left.len(),
            right.len()
        )));
    }
    Ok(left
        .iter()
        .cloned()
        .zip(right.iter().cloned())
        .map(|(l, r)| [l, r])
        .collect())
}

/// Two folders by name; one folder for both where names tell the eyes apart.
fn folders(left: &Path, right: &Path) -> Result<Vec<[PathBuf; 2]>, Fault> {
    let mut sides = [pictures(left)?, pictures(right)?];
    if left == right {
        for (side, eye) in sides.iter_mut().zip(Eye::BOTH) {
            side.retain(|file| names::eye_in_name(file).is_some_and(|(of, _)| of == eye));
            if side.is_empty() {
                return Err(fault::usage(format!(
                    "no name tells which pictures are the {} eye's: {}",
                    ["left", "right"][usize::from(eye == Eye::Right)],
                    left.display()
                )));
            }
        }
    }
    let key = |file: &PathBuf| {
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        names::eye_in_name(file).map_or_else(|| stem.to_lowercase(), |(_, rest)| rest)
    };
    let [lefts, rights] = sides;
    let mut rights: BTreeMap<String, PathBuf> = rights.into_iter().map(|f| (key(&f), f)).collect();
    let mut found = Vec::new();
    for file in lefts {
        match rights.remove(&key(&file)) {
            Some(partner) => found.push([file, partner]),
            None => return Err(alone(&file, right)),
        }
    }
    match rights.into_values().next() {
        Some(file) => Err(alone(&file, left)),
        None => Ok(found),
    }
}

fn alone(file: &Path, other: &Path) -> Fault {
    fault::usage(format!(
        "{} has no partner: {} holds no picture of this name",
        file.display(),
        other.display()
    ))
    .hint("put what belongs to no pair elsewhere, or name the files of both eyes in their order")
}

/// The pictures of a folder, in order of name.
fn pictures(folder: &Path) -> Result<Vec<PathBuf>, Fault> {
    let failed = |e: std::io::Error| {
        fault::usage(format!(
            "the folder cannot be listed: {e}: {}",
            folder.display()
        ))
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        let hidden = file
            .file_name()
            .is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if !hidden && names::is_picture(&file) && file.is_file() {
            files.push(file);
        }
    }
    if files.is_empty() {
        return Err(fault::usage(format!(
            "the folder holds no pictures: {}",
            folder.display()
        )));
    }
    files.sort();
    Ok(files)
}
