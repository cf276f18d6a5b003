//! What the names of files say: which eye, which layout, picture or film. Weak evidence, and treated as such.

use std::path::Path;

use vergence_geometry::Eye;
use vergence_imaging::stereo_file::{Halves, Order};

/// Endings of picture files that are looked for in folders; what a file is, its content says.
const PICTURES: [&str; 15] = [
    "png", "jpg", "jpeg", "jpe", "mpo", "jps", "pns", "tif", "tiff", "webp", "bmp", "gif", "pgm",
    "ppm", "pnm",
];

/// Endings of films, which go through ffmpeg.
const FILMS: [&str; 15] = [
    "mp4", "m4v", "mov", "mkv", "mk3d", "webm", "avi", "mpg", "mpeg", "ts", "mts", "m2ts", "wmv",
    "ogv", "mjpeg",
];

/// Whether the name is that of a picture.
pub(crate) fn is_picture(path: &Path) -> bool {
    has_ending(path, &PICTURES)
}

/// Whether the name is that of a film, or an address.
pub(crate) fn is_film(path: &Path) -> bool {
    has_ending(path, &FILMS) || is_address(path)
}

/// Whether it is an address (rtsp://...) and no file.
pub(super) fn is_address(path: &Path) -> bool {
    path.to_str().is_some_and(|s| s.contains("://"))
}

/// Whether the file's ending says that it holds two eyes for viewing with crossed eyes (JPS and PNS without a tag).
pub(super) fn is_crossed_by_ending(path: &Path) -> bool {
    has_ending(path, &["jps", "pns"])
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    endings.iter().any(|e| ending.eq_ignore_ascii_case(e))
}

/// The stem in lower case.
fn stem(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().to_lowercase()
}

/// The eye in a name and the name without it: `view_left_03` is the left one of `view__03`, `left03` of `03`, `a_r` of `a_`.
pub(crate) fn eye_in_name(path: &Path) -> Option<(Eye, String)> {
    let stem = stem(path);
    let is_word = |c: char| c.is_ascii_alphanumeric();
    for (word, eye) in [("left", Eye::Left), ("right", Eye::Right)] {
        // At the beginning or the end, or between signs; "leftover" is not the left eye of "over".
        for (at, _) in stem.match_indices(word) {
            let (before, after) = (&stem[..at], &stem[at + word.len()..]);
            let ends = |c: Option<char>| c.is_none_or(|c| !c.is_ascii_alphabetic());
            if ends(before.chars().next_back()) && ends(after.chars().next()) {
                return Some((eye, format!("{before}{after}")));
            }
        }
    }
    for (word, eye) in [("l", Eye::Left), ("r", Eye::Right)] {
        let mut at = 0;
        for token in stem.split(|c| !is_word(c)) {
            if token == word && stem.len() > 1 {
                return Some((eye, format!("{}{}", &stem[..at], &stem[at + 1..])));
            }
            at += token.len() + 1;
        }
    }
    None
}

/// The last part of a name as a layout: `_sbs`, `_lr`, `_ou` and their relatives, `h` before them for squeezed halves.
pub(super) fn layout_in_name(path: &Path) -> Option<(&'static str, Halves, Order, Option<bool>)> {
    use Halves::{OverUnder, SideBySide};
    use Order::{LeftFirst, RightFirst};
    const WORDS: [(&str, Halves, Order, Option<bool>); 20] = [
        ("lr", SideBySide, LeftFirst, None),
        ("lrh", SideBySide, LeftFirst, Some(true)),
        ("lrq", SideBySide, LeftFirst, Some(true)),
        ("rl", SideBySide, RightFirst, None),
        ("sbs", SideBySide, LeftFirst, None),
        ("fsbs", SideBySide, LeftFirst, Some(false)),
        ("hsbs", SideBySide, LeftFirst, Some(true)),
        ("crosseye", SideBySide, RightFirst, None),
        ("crossed", SideBySide, RightFirst, None),
        ("xeye", SideBySide, RightFirst, None),
        ("parallel", SideBySide, LeftFirst, None),
        ("ou", OverUnder, LeftFirst, None),
        ("hou", OverUnder, LeftFirst, Some(true)),
        ("fou", OverUnder, LeftFirst, Some(false)),
        ("tb", OverUnder, LeftFirst, None),
        ("tab", OverUnder, LeftFirst, None),
        ("htab", OverUnder, LeftFirst, Some(true)),
        ("ab", OverUnder, LeftFirst, None),
        ("bt", OverUnder, RightFirst, None),
        ("abq", OverUnder, LeftFirst, Some(true)),
    ];
    let stem = stem(path);
    let (before, token) = stem.rsplit_once(['_', '-', '.', ' '])?;
    let whole = [
        before.rsplit(['_', '-', '.', ' ']).next().unwrap_or(""),
        token,
    ]
    .concat();
    let known = |word: &str| WORDS.into_iter().find(|(known, ..)| *known == word);
    // "half_sbs" and "h-ou" are one word in two parts.
    match whole.as_str() {
        "halfsbs" | "hsbs" => known("hsbs"),
        "halfou" | "hou" | "halftb" => known("hou"),
        _ => known(token),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn eye(name: &str) -> Option<(Eye, String)> {
        eye_in_name(Path::new(name))
    }

    /// Eyes are found where people write them, and nowhere else; partners have one key.
    #[test]
    fn eyes_in_names() {
        assert_eq!(eye("left.png"), Some((Eye::Left, String::new())));
        for (left, right) in [
            ("left_0036.jpg", "right_0036.jpg"),
            ("view_LEFT_03.png", "view_RIGHT_03.png"),
            ("left01.jpg", "right01.jpg"),
            ("pond_l.jpg", "pond_r.jpg"),
            ("L-7.tif", "R-7.tif"),
            ("a.left.png", "a.right.png"),
        ] {
            let (l, r) = (eye(left).unwrap(), eye(right).unwrap());
            assert_eq!((l.0, r.0, &l.1), (Eye::Left, Eye::Right, &r.1), "{left}");
        }
        for name in [
            "leftover.png",
            "bright.png",
            "l.png",
            "lr.png",
            "pond_lr.jpg",
            "table.png",
        ] {
            assert_eq!(eye(name), None, "{name}");
        }
    }

    /// The last part of a name may say the layout.
    #[test]
    fn layouts_in_names() {
        let layout = |name: &str| layout_in_name(Path::new(name));
        let (_, halves, order, squeezed) = layout("gopro_pair_lr.jpg").unwrap();
        assert_eq!(
            (halves, order, squeezed),
            (Halves::SideBySide, Order::LeftFirst, None)
        );
        assert_eq!(layout("a_hsbs.png").unwrap().3, Some(true));
        assert_eq!(layout("a_half_sbs.png").unwrap().3, Some(true));
        assert_eq!(layout("a-rl.png").unwrap().2, Order::RightFirst);
        assert_eq!(layout("film.TB.mp4").unwrap().1, Halves::OverUnder);
        assert_eq!(layout("lr.png"), None);
        assert_eq!(layout("colour.png"), None);
    }

    /// Endings, whatever their case.
    #[test]
    fn kinds_by_ending() {
        assert!(is_picture(Path::new("A.MPO")) && !is_picture(Path::new("a.txt")));
        assert!(is_film(Path::new("a.MKV")) && is_film(Path::new("rtsp://camera/1")));
        assert!(is_crossed_by_ending(Path::new("x.jps")));
    }
}
