//! What may be secret in the address of a stream (user, password, query) is told nowhere.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

/// What stands for a secret in a text that is not ours.
const HIDDEN: &str = "…";

/// A path, or a URL without user, password and query.
pub(crate) fn shown(path: &Path) -> String {
    shown_text(&path.to_string_lossy())
}

/// The same to stand in an error where a path is wanted; what is no URL stays as it is.
pub(crate) fn shown_path(path: &Path) -> PathBuf {
    if path.to_string_lossy().contains("://") {
        PathBuf::from(shown(path))
    } else {
        path.to_owned()
    }
}

fn shown_text(text: &str) -> String {
    let Some((scheme, rest)) = text.split_once("://") else {
        return text.to_owned();
    };
    // A password may hold a question mark by mistake, so what stands before the last @ goes first.
    let rest = rest.rsplit('@').next().unwrap_or_default();
    let rest = rest.split(['?', '#']).next().unwrap_or_default();
    format!("{scheme}://{rest}")
}

/// Words of a program or a library about `path` without what is secret in it: the address as it was given becomes the one that is shown, and so
/// does any other address; user, password and query are hidden where they stand alone.
pub(crate) fn cleaned<'a>(words: &'a str, path: &Path) -> Cow<'a, str> {
    let address = path.to_string_lossy();
    let Some((_, rest)) = address.split_once("://") else {
        return Cow::Borrowed(words);
    };
    let mut clean = words.replace(&*address, &shown(path));
    let user = rest.rsplit_once('@').map(|(user, _)| user);
    let password = user.and_then(|user| user.split_once(':')).map(|p| p.1);
    let query = rest.rsplit('@').next().unwrap_or_default();
    let query = query.split_once('?').map(|(_, query)| query);
    for secret in [user, password, query].into_iter().flatten() {
        if !secret.is_empty() {
            clean = clean.replace(secret, HIDDEN);
        }
    }
    // Another spelling of the address, or one that a server led to.
    let parts: Vec<String> = clean
        .split_inclusive([' ', '\'', '"', ',', '\n'])
        .map(|part| {
            let end = part.trim_end_matches([' ', '\'', '"', ',', '\n']).len();
            format!("{}{}", shown_text(&part[..end]), &part[end..])
        })
        .collect();
    Cow::Owned(parts.concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Secrets of a URL are not shown; paths are shown as they are.
    #[test]
    fn secrets_are_not_shown() {
        for (given, told) in [
            (
                "rtsp://admin:pw@10.0.0.7:554/a/b?key=1#x",
                "rtsp://10.0.0.7:554/a/b",
            ),
            ("rtsp://u:p/w@host", "rtsp://host"),
            ("http://host", "http://host"),
            ("/dev/video0", "/dev/video0"),
        ] {
            assert_eq!(shown(Path::new(given)), told);
            assert_eq!(shown_path(Path::new(given)), Path::new(told));
        }
    }

    /// Words of others lose the address as given, in another spelling, and its parts; words about files stay.
    #[test]
    fn words_are_cleaned() {
        let path = Path::new("rtsp://admin:s3 cret@host:554/main?token=abc");
        for (said, told) in [
            (
                "Error opening input file rtsp://admin:s3 cret@host:554/main?token=abc.",
                "Error opening input file rtsp://host:554/main.",
            ),
            (
                "from 'rtsp://admin:other@host:554/main?x=1': refused",
                "from 'rtsp://host:554/main",
            ),
            ("user admin, password s3 cret", "user admin, password …"),
            ("GET /main?token=abc", "GET /main?…"),
            ("401 Unauthorized", "401 Unauthorized"),
        ] {
            let clean = cleaned(said, path);
            assert!(clean.starts_with(told), "{clean}");
            for secret in ["s3 cret", "other", "abc", "x=1"] {
                assert!(!clean.contains(secret), "{clean}");
            }
        }
        let file = Path::new("a:b@c.mp4");
        assert_eq!(cleaned("a:b@c.mp4: no video", file), "a:b@c.mp4: no video");
    }
}
