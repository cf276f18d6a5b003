//! From what was typed to a list of items.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use vergence_geometry::Eye;

use crate::fault::{self, Fault};
use crate::output;

use super::names;

/// Most items of one call.
const MAX_ITEMS: usize = 1_000_000;

/// Largest list that is read, bytes.
const MAX_LIST_BYTES: u64 = 64 << 20;

/// Something to grade.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Item {
    /// As it is called in results.
    pub(super) name: String,
    pub(super) source: Source,
    /// What one should know of how it was chosen.
    pub(super) remarks: Vec<String>,
}

/// Where the pictures of an item are.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Source {
    /// One file with one picture or two eyes.
    File(PathBuf),
    /// A file for each eye.
    Pair(PathBuf, PathBuf),
    /// A film with one or two eyes.
    Film(PathBuf),
    /// A film for each eye.
    Films(PathBuf, PathBuf),
    /// Pictures or pairs in the order of time.
    Sequence(Vec<Item>),
    /// It cannot be graded, and why.
    Unusable(String),
}

/// All items, and whether the call names several things by its nature.
pub(super) struct Inputs {
    pub(super) items: Vec<Item>,
    pub(super) several: bool,
}

/// What was typed.
pub(super) struct Typed<'a> {
    pub(super) inputs: &'a [PathBuf],
    pub(super) left: Option<&'a Path>,
    pub(super) right: Option<&'a Path>,
    pub(super) list: Option<&'a Path>,
    /// Folders and lists are in the order of time.
    pub(super) sequence: bool,
}

/// The items of a call.
///
/// # Errors
/// What is typed and not there is a mistake of the call; what a folder or a list holds is not.
pub(super) fn items(typed: &Typed<'_>) -> Result<Inputs, Fault> {
    let mut items = Vec::new();
    let mut several = typed.inputs.len() > 1;
    match (typed.left, typed.right) {
        (Some(left), Some(right)) => {
            let found = two_sides(left, right)?;
            several |= left.is_dir() || found.len() > 1;
            items.extend(found);
        }
        (None, None) => {}
        _ => {
            return Err(fault::usage("--left and --right belong together")
                .hint("name both, or one file that holds both eyes without a flag"));
        }
    }
    for input in typed.inputs {
        let text = input.to_string_lossy();
        if let Some(list) = text.strip_prefix('@') {
            several = true;
            items.extend(listed(Path::new(list))?);
        } else {
            several |= input.is_dir();
            items.extend(named(input)?);
        }
    }
    if let Some(list) = typed.list {
        several = true;
        items.extend(listed(list)?);
    }
    if items.is_empty() {
        return Err(fault::usage("nothing to grade was named").hint(
            "vergence grade PICTURE, --left L --right R, a folder, a film, or @list.txt; see vergence grade --help",
        ));
    }
    several |= items
        .iter()
        .any(|i| matches!(i.source, Source::Film(_) | Source::Films(..)));
    if typed.sequence {
        several = true;
        items = vec![Item {
            name: format!("sequence of {} items from {}", items.len(), items[0].name),
            source: Source::Sequence(items),
            remarks: Vec::new(),
        }];
    }
    Ok(Inputs { items, several })
}

fn not_there(path: &Path) -> Fault {
    fault::usage(format!(
        "there is no such file or folder: {}",
        path.display()
    ))
}

fn item(path: &Path, source: Source) -> Item {
    Item {
        name: path.display().to_string(),
        source,
        remarks: Vec::new(),
    }
}

/// One input without a flag.
fn named(path: &Path) -> Result<Vec<Item>, Fault> {
    if path.is_dir() {
        return folder(path);
    }
    if !path.exists() && !names::is_address(path) {
        return Err(not_there(path));
    }
    if names::is_film(path) {
        return Ok(vec![item(path, Source::Film(path.to_owned()))]);
    }
    Ok(vec![item(path, Source::File(path.to_owned()))])
}

/// A pair of files, films or folders.
fn two_sides(left: &Path, right: &Path) -> Result<Vec<Item>, Fault> {
    let mixed = |what: &str| {
        fault::usage(format!(
            "--left and --right must be two {what}: {} and {}",
            left.display(),
            right.display()
        ))
    };
    match (left.is_dir(), right.is_dir()) {
        (true, true) => return two_folders(left, right),
        (false, false) => {}
        _ => return Err(mixed("folders, two pictures or two films")),
    }
    let missing = |p: &&Path| !p.exists() && !names::is_address(p);
    if let Some(missing) = [left, right].into_iter().find(missing) {
        return Err(not_there(missing));
    }
    let name = format!("{} + {}", left.display(), right.display());
    let source = match (names::is_film(left), names::is_film(right)) {
        (true, true) => Source::Films(left.to_owned(), right.to_owned()),
        (false, false) => Source::Pair(left.to_owned(), right.to_owned()),
        _ => return Err(mixed("films or two pictures")),
    };
    Ok(vec![Item {
        name,
        source,
        remarks: Vec::new(),
    }])
}

/// What a folder holds: a run of `vergence run`, the folders `left` and `right`, or pictures, pairs and films in order of name.
fn folder(path: &Path) -> Result<Vec<Item>, Fault> {
    if path.join("summary.json").is_file() && path.join("frames.csv").is_file() {
        return recording(path);
    }
    let files = files_of(path)?;
    let [left, right] = ["left", "right"].map(|side| path.join(side));
    if files.is_empty() && left.is_dir() && right.is_dir() {
        return two_folders(&left, &right);
    }
    if files.is_empty() {
        return Err(fault::usage(format!("the folder holds no pictures and no films: {}", path.display()))
            .hint("pictures are known by their endings (png, jpg, mpo, jps, tif, webp, bmp, gif, pgm ...); folders in it are not searched"));
    }
    Ok(paired(&files))
}

/// The pictures and films of a folder, in order of name.
fn files_of(path: &Path) -> Result<Vec<PathBuf>, Fault> {
    let failed = |e: std::io::Error| {
        fault::usage(format!(
            "the folder cannot be listed: {e}: {}",
            path.display()
        ))
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        let hidden = file
            .file_name()
            .is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if !hidden && (names::is_picture(&file) || names::is_film(&file)) && !file.is_dir() {
            files.push(file);
        }
        if files.len() > MAX_ITEMS {
            return Err(fault::usage(format!(
                "the folder holds more than {MAX_ITEMS} files: {}",
                path.display()
            )));
        }
    }
    files.sort();
    Ok(files)
}

/// Files by themselves and pairs whose names differ in the eye alone, in order of name.
fn paired(files: &[PathBuf]) -> Vec<Item> {
    let key = |file: &Path| {
        let (eye, rest) = names::eye_in_name(file)?;
        let ending = file.extension().unwrap_or_default().to_ascii_lowercase();
        Some((eye, (rest, ending)))
    };
    let mut rights = BTreeMap::new();
    for file in files {
        if let Some((Eye::Right, key)) = key(file) {
            rights.insert(key, file.clone());
        }
    }
    let mut items = Vec::new();
    for file in files {
        if let Some((Eye::Left, key)) = key(file)
            && let Some(right) = rights.remove(&key)
        {
            items.push(Item {
                name: format!("{} + {}", file.display(), last_part(&right)),
                source: if names::is_film(file) {
                    Source::Films(file.clone(), right)
                } else {
                    Source::Pair(file.clone(), right)
                },
                remarks: Vec::new(),
            });
        } else if key(file).is_none_or(|(eye, _)| eye == Eye::Left) {
            items.push(alone(file, key(file).is_some()));
        }
    }
    items.extend(rights.into_values().map(|file| alone(&file, true)));
    items.sort_by(|a, b| a.name.cmp(&b.name));
    items
}

/// A file without a partner.
fn alone(file: &Path, names_an_eye: bool) -> Item {
    let source = if names::is_film(file) {
        Source::Film(file.to_owned())
    } else {
        Source::File(file.to_owned())
    };
    let mut item = item(file, source);
    if names_an_eye {
        item.remarks
            .push("its name names an eye, and the other eye's file is not there".to_owned());
    }
    item
}

/// Two folders, a file for each eye under one name (an eye in it does not count), else in order where no name fits.
fn two_folders(left: &Path, right: &Path) -> Result<Vec<Item>, Fault> {
    let sides = [files_of(left)?, files_of(right)?];
    for (side, path) in sides.iter().zip([left, right]) {
        if side.is_empty() {
            return Err(fault::usage(format!(
                "the folder holds no pictures: {}",
                path.display()
            )));
        }
    }
    let key = |file: &PathBuf| {
        names::eye_in_name(file).map_or_else(
            || {
                file.file_stem()
                    .unwrap_or_default()
                    .to_string_lossy()
                    .to_lowercase()
            },
            |(_, rest)| rest,
        )
    };
    let [lefts, rights] = sides;
    let mut by_key: BTreeMap<String, PathBuf> = rights.into_iter().map(|f| (key(&f), f)).collect();
    let mut items = Vec::new();
    for file in lefts {
        let name = file.display().to_string();
        items.push(match by_key.remove(&key(&file)) {
            Some(partner) => Item {
                name: format!("{name} + {}", partner.display()),
                source: Source::Pair(file, partner),
                remarks: Vec::new(),
            },
            None => unusable(
                name,
                format!("{} holds no picture of this name", right.display()),
            ),
        });
    }
    for file in by_key.into_values() {
        let why = format!("{} holds no picture of this name", left.display());
        items.push(unusable(file.display().to_string(), why));
    }
    Ok(items)
}

fn unusable(name: String, why: String) -> Item {
    Item {
        name,
        source: Source::Unusable(why),
        remarks: Vec::new(),
    }
}

/// A folder of `vergence run`: what it shows of the pair is the film side by side and, of recorded pairs, the turned pair.
fn recording(path: &Path) -> Result<Vec<Item>, Fault> {
    let mut items = Vec::new();
    let [left, right] = ["converged_left.png", "converged_right.png"].map(|n| path.join(n));
    if left.is_file() && right.is_file() {
        items.push(Item {
            name: format!("{} + {}", left.display(), last_part(&right)),
            source: Source::Pair(left, right),
            remarks: vec!["the pair as the run showed it, turned to the target".to_owned()],
        });
    }
    let film = path.join("sample_side_by_side.avi");
    let still = path.join("sample_side_by_side.png");
    let small = "from the sample of a run: the pair as shown, reduced to at most 512 pixels of width an eye";
    let chosen = if film.is_file() {
        Some((film.clone(), Source::Film(film)))
    } else if still.is_file() {
        Some((still.clone(), Source::File(still)))
    } else {
        None
    };
    if let Some((file, source)) = chosen {
        let mut item = item(&file, source);
        item.remarks.push(small.to_owned());
        items.push(item);
    }
    if items.is_empty() {
        return Err(fault::usage(format!(
            "this run left no pair to grade (no sample_side_by_side.avi, no converged_left.png): {}",
            path.display()
        )));
    }
    Ok(items)
}

/// The items of a list file: a path a line, or two with a tab between them; empty lines and those that begin with # do not count.
/// Paths are taken from the folder in which the list lies.
fn listed(list: &Path) -> Result<Vec<Item>, Fault> {
    let text =
        output::read_text(list, "list", MAX_LIST_BYTES).map_err(|e| fault::usage(e.to_string()))?;
    let base = list.parent().unwrap_or(Path::new(""));
    let mut items = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let line = line.trim_end_matches('\r');
        if line.trim().is_empty() || line.starts_with('#') {
            continue;
        }
        if items.len() == MAX_ITEMS {
            return Err(fault::usage(format!(
                "more than {MAX_ITEMS} lines: list {}",
                list.display()
            )));
        }
        let found = match line.split_once('\t') {
            Some((left, right)) => two_sides(&base.join(left.trim()), &base.join(right.trim())),
            None => named(&base.join(line.trim())),
        };
        // A line of a list that names nothing does not stop the others.
        items.extend(found.unwrap_or_else(|fault| {
            vec![unusable(
                format!("{} line {}", list.display(), i + 1),
                fault.to_string(),
            )]
        }));
    }
    if items.is_empty() {
        return Err(fault::usage(format!(
            "the list names nothing: {}",
            list.display()
        )));
    }
    Ok(items)
}

/// The last part of a path, for messages.
pub(super) fn last_part(path: &Path) -> String {
    path.file_name()
        .unwrap_or(path.as_os_str())
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sources(files: &[&str]) -> Vec<Source> {
        let items = paired(&files.iter().map(PathBuf::from).collect::<Vec<_>>());
        items.into_iter().map(|i| i.source).collect()
    }

    /// Names that differ in the eye alone are a pair; what has no partner stays and says so.
    #[test]
    fn folders_are_paired_by_name() {
        let file = |n: &str| Source::File(PathBuf::from(n));
        let pair = |l: &str, r: &str| Source::Pair(PathBuf::from(l), PathBuf::from(r));
        let files = [
            "a_l.png",
            "a_r.png",
            "b.png",
            "left_1.jpg",
            "left_2.jpg",
            "right_1.jpg",
            "right_3.jpg",
        ];
        assert_eq!(
            sources(&files),
            [
                pair("a_l.png", "a_r.png"),
                file("b.png"),
                pair("left_1.jpg", "right_1.jpg"),
                file("left_2.jpg"),
                file("right_3.jpg"),
            ]
        );
        let lone = paired(&[PathBuf::from("left_2.jpg")]);
        assert!(lone[0].remarks[0].contains("the other eye's file is not there"));
        // Another kind of file is no partner: it may be a preview.
        assert_eq!(sources(&["x_l.png", "x_r.jpg"]).len(), 2);
    }
}
