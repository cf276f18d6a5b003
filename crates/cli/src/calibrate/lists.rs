//! From what was typed to pictures with their camera and their place in the sequence.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::fault::{self, Fault};
use crate::grade::names::is_film;

/// Most pictures of one call.
const MAX_PICTURES: usize = 20_000;

/// Most cameras of one call.
const MAX_CAMERAS: usize = 64;

/// One picture.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub(crate) path: PathBuf,
    pub(crate) camera: usize,
    /// Pictures of one group were taken together.
    pub(crate) group: usize,
    /// Width and height, px; known once it was looked at.
    pub(crate) size: (usize, usize),
}

/// Names of the cameras, and all pictures in the order of cameras and groups.
pub(crate) fn views(
    left: &[PathBuf],
    right: &[PathBuf],
    cameras: &[String],
) -> Result<(Vec<String>, Vec<View>), Fault> {
    let named: Vec<(String, Vec<PathBuf>)> = if !left.is_empty() {
        vec![
            ("left".to_owned(), pictures(left)?),
            ("right".to_owned(), pictures(right)?),
        ]
    } else {
        of_cameras(cameras)?
    };
    let count: usize = named.iter().map(|(_, files)| files.len()).sum();
    if count > MAX_PICTURES {
        return Err(fault::usage(format!(
            "{count} pictures; one call takes {MAX_PICTURES}"
        )));
    }
    let groups = groups(&named)?;
    let views = named
        .iter()
        .enumerate()
        .flat_map(|(camera, (_, files))| {
            let groups = &groups[camera];
            files.iter().zip(groups).map(move |(path, group)| View {
                path: path.clone(),
                camera,
                group: *group,
                size: (0, 0),
            })
        })
        .collect();
    Ok((named.into_iter().map(|(name, _)| name).collect(), views))
}

/// Names of the cameras and a film of each.
pub(crate) type Films = (Vec<String>, Vec<PathBuf>);

/// Names of the cameras with a film of each, when films were named; `None` for pictures.
pub(crate) fn films(
    left: &[PathBuf],
    right: &[PathBuf],
    cameras: &[String],
) -> Result<Option<Films>, Fault> {
    let named: Vec<(String, PathBuf)> = if left.is_empty() {
        let alone = cameras.len() == 1;
        let named = cameras.iter().map(|text| match text.split_once('=') {
            // A URL may hold an equals sign of its own.
            Some((name, path)) if !name.is_empty() && !name.contains("://") => {
                (name.to_owned(), PathBuf::from(path))
            }
            _ if alone => ("camera".to_owned(), PathBuf::from(text)),
            _ => (String::new(), PathBuf::from(text)),
        });
        named.collect()
    } else {
        let eyes = [("left", left), ("right", right)].into_iter();
        eyes.flat_map(|(name, paths)| paths.iter().map(move |p| (name.to_owned(), p.clone())))
            .collect()
    };
    let count = named.iter().filter(|(_, p)| is_film(p)).count();
    if count == 0 {
        return Ok(None);
    }
    let names: std::collections::BTreeSet<&String> = named.iter().map(|(name, _)| name).collect();
    if count < named.len() || names.len() < named.len() || names.iter().any(|n| n.is_empty()) {
        return Err(fault::usage(
            "films and pictures cannot be mixed, and every camera has one film with a name of its own",
        )
        .hint("for example --left left.mp4 --right right.mp4, or --camera a=a.mp4 --camera b=b.mp4"));
    }
    if let Some((_, missing)) = named
        .iter()
        .find(|(_, p)| !p.to_string_lossy().contains("://") && !p.is_file())
    {
        return Err(fault::usage(format!(
            "there is no such file or folder: {}",
            missing.display()
        )));
    }
    Ok(Some(named.into_iter().unzip()))
}

fn of_cameras(cameras: &[String]) -> Result<Vec<(String, Vec<PathBuf>)>, Fault> {
    if cameras.is_empty() {
        return Err(fault::usage("no pictures were named")
            .hint("name --left and --right of a pair, or --camera once for every camera"));
    }
    if cameras.len() > MAX_CAMERAS {
        return Err(fault::usage(format!(
            "{} cameras; one call takes {MAX_CAMERAS}",
            cameras.len()
        )));
    }
    let mut named: Vec<(String, Vec<PathBuf>)> = Vec::new();
    for text in cameras {
        let (name, path) = match text.split_once('=') {
            Some((name, path)) if !name.is_empty() => (name.to_owned(), path),
            _ if cameras.len() == 1 => ("camera".to_owned(), text.as_str()),
            _ => {
                return Err(fault::usage(format!("--camera {text} has no name")).hint(
                    "of several cameras each needs one: --camera left=folder --camera right=folder",
                ));
            }
        };
        if named.iter().any(|(n, _)| *n == name) {
            return Err(fault::usage(format!("two cameras are called {name}")));
        }
        named.push((name, pictures(&[PathBuf::from(path)])?));
    }
    Ok(named)
}

/// Picture files as they were typed; a folder stands for the pictures in it.
fn pictures(typed: &[PathBuf]) -> Result<Vec<PathBuf>, Fault> {
    let mut files = Vec::new();
    for path in typed {
        if path.is_dir() {
            let entries = std::fs::read_dir(path).map_err(|e| {
                fault::usage(format!("cannot read the folder {}: {e}", path.display()))
            })?;
            let mut found: Vec<PathBuf> = entries
                .filter_map(|entry| Some(entry.ok()?.path()))
                .filter(|p| p.is_file() && is_picture(p))
                .collect();
            if found.is_empty() {
                return Err(fault::usage(format!(
                    "there is no picture in the folder {}",
                    path.display()
                )));
            }
            found.sort_by_cached_key(|p| natural(p));
            files.extend(found);
        } else if path.is_file() {
            files.push(path.clone());
        } else {
            return Err(fault::usage(format!(
                "there is no such file or folder: {}",
                path.display()
            )));
        }
    }
    Ok(files)
}

fn is_picture(path: &Path) -> bool {
    let extension = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default();
    let known = [
        "png", "jpg", "jpeg", "bmp", "tif", "tiff", "pgm", "ppm", "webp", "gif",
    ];
    known.iter().any(|k| extension.eq_ignore_ascii_case(k))
}

/// A name with its numbers as numbers: 2 before 10.
fn natural(path: &Path) -> Vec<(String, u64)> {
    let name = path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let mut parts = Vec::new();
    let mut rest = name.as_str();
    while !rest.is_empty() {
        let text = rest
            .find(|c: char| c.is_ascii_digit())
            .unwrap_or(rest.len());
        let (words, tail) = rest.split_at(text);
        let digits = tail
            .find(|c: char| !c.is_ascii_digit())
            .unwrap_or(tail.len());
        let (number, tail) = tail.split_at(digits);
        parts.push((words.to_owned(), number.parse().unwrap_or(u64::MAX)));
        rest = tail;
    }
    parts
}

/// The last number in a file's name.
fn number_of(path: &Path) -> Option<u64> {
    let stem = path.file_stem()?.to_string_lossy().into_owned();
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |i| i + 1);
    stem[start..end].parse().ok()
}

/// Which pictures were taken together: by the last number in their names where each camera has each number once, else by their order.
fn groups(cameras: &[(String, Vec<PathBuf>)]) -> Result<Vec<Vec<usize>>, Fault> {
    if cameras.len() == 1 {
        return Ok(vec![(0..cameras[0].1.len()).collect()]);
    }
    let first = cameras[0].1.len();
    let equal = cameras.iter().all(|(_, files)| files.len() == first);
    if let Some(numbers) = numbers(cameras) {
        let mut holders: BTreeMap<u64, usize> = BTreeMap::new();
        for n in numbers.iter().flatten() {
            *holders.entry(*n).or_default() += 1;
        }
        let lonely = numbers
            .iter()
            .zip(cameras)
            .find_map(|(own, (name, files))| {
                let place = own.iter().position(|n| holders[n] < 2)?;
                Some((name, &files[place]))
            });
        return match lonely {
            None => {
                let order: BTreeMap<u64, usize> =
                    holders.keys().enumerate().map(|(i, n)| (*n, i)).collect();
                let group = |own: &Vec<u64>| own.iter().map(|n| order[n]).collect();
                Ok(numbers.iter().map(group).collect())
            }
            // Numbers that never meet are no pairing at all: frames counted on, one camera after the other.
            Some(_) if equal && holders.values().all(|n| *n == 1) => Ok(by_order(cameras)),
            Some((name, file)) => Err(unequal(cameras)
                .map(|text| format!("{text}: {} of camera {name} has no partner", file.display()))),
        };
    }
    match equal {
        true => Ok(by_order(cameras)),
        false => Err(unequal(cameras)),
    }
}

fn by_order(cameras: &[(String, Vec<PathBuf>)]) -> Vec<Vec<usize>> {
    let count = |files: &Vec<PathBuf>| (0..files.len()).collect();
    cameras.iter().map(|(_, files)| count(files)).collect()
}

fn unequal(cameras: &[(String, Vec<PathBuf>)]) -> Fault {
    let counts: Vec<String> = cameras
        .iter()
        .map(|(name, files)| format!("{} of camera {name}", files.len()))
        .collect();
    fault::usage(format!(
        "the cameras' pictures do not pair up ({})",
        counts.join(", ")
    ))
    .hint(
        "name as many pictures of each camera, taken together, with the same number in their names",
    )
}

/// The number of every picture, if every picture has one and no camera has one twice.
fn numbers(cameras: &[(String, Vec<PathBuf>)]) -> Option<Vec<Vec<u64>>> {
    cameras
        .iter()
        .map(|(_, files)| {
            let own: Option<Vec<u64>> = files.iter().map(|p| number_of(p)).collect();
            own.filter(|own| {
                let mut sorted = own.clone();
                sorted.sort_unstable();
                sorted.windows(2).all(|w| w[0] != w[1])
            })
        })
        .collect()
}

/// The folder of the file to write must be there before anything is worked out.
pub(crate) fn check_out(out: Option<&Path>) -> Result<(), Fault> {
    let Some(path) = out else {
        return Ok(());
    };
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    if folder.is_some_and(|f| !f.is_dir()) {
        return Err(fault::usage(format!(
            "--out {}: there is no such folder",
            path.display()
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(name: &str, files: &[&str]) -> (String, Vec<PathBuf>) {
        (name.to_owned(), files.iter().map(PathBuf::from).collect())
    }

    /// Numbers pair pictures whatever their order; where there are none, the order does; what has no partner is named.
    #[test]
    fn pictures_are_paired() {
        let paired = [
            camera("l", &["left2.png", "left10.png"]),
            camera("r", &["right10.png", "right02.png"]),
        ];
        assert_eq!(groups(&paired).unwrap(), vec![vec![0, 1], vec![1, 0]]);
        let plain = [
            camera("l", &["a.png", "b.png"]),
            camera("r", &["c.png", "d.png"]),
        ];
        assert_eq!(groups(&plain).unwrap(), vec![vec![0, 1], vec![0, 1]]);
        let counted_on = [
            camera("l", &["1.png", "2.png"]),
            camera("r", &["3.png", "4.png"]),
        ];
        assert_eq!(groups(&counted_on).unwrap(), vec![vec![0, 1], vec![0, 1]]);
        let lonely = [camera("l", &["l1.png", "l2.png"]), camera("r", &["r1.png"])];
        let told = groups(&lonely).unwrap_err().to_string();
        assert!(
            told.contains("l2.png") && told.contains("2 of camera l"),
            "{told}"
        );
        let unnumbered = [camera("l", &["a.png", "b.png"]), camera("r", &["c.png"])];
        assert!(groups(&unnumbered).is_err());
    }

    /// Numbers in names count as numbers.
    #[test]
    fn ten_comes_after_two() {
        let mut files = [PathBuf::from("a10.png"), PathBuf::from("a2.png")];
        files.sort_by_cached_key(|p| natural(p));
        assert_eq!(files[0], PathBuf::from("a2.png"));
        assert_eq!(number_of(Path::new("cam0_frame_0012.png")), Some(12));
        assert_eq!(number_of(Path::new("left.png")), None);
    }
}
