//! Proves of `vergence grade --report`, end to end: the page of a real pair with a planted vertical offset shows it as bad, holds its pictures and drawings,
//! and a real browser (Debian's chromium, headless; said to be skipped where there is none) lays it out without an error, a request or a page wider
//! than the window. What the page does with made-up data is proved in `grade/report/tests.rs`.

use std::path::Path;
use std::process::Command;

use crate::common::{Done, Place};
use vergence_imaging::Rgb;
use vergence_imaging::files::{read_rgb, write_rgb};

/// Models of libsvm's own making: its scores mean nothing, but scores they are.
const LIBSVM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../quality/tests/libsvm");
const LEAVES: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../quality/tests/data/leaves_c_ref.png"
);

/// Run in the place with a data folder that holds the model `test`.
fn vergence(place: &Place, args: &[&str]) -> Done {
    let mut command = place.command(args);
    command.env("VERGENCE_DATA_DIR", place.path().join("data"));
    Done::from(command.output().expect("the program starts"))
}

/// A pair of which the right picture is 4 px to the right and 7 px lower, and a third that is no picture.
fn place() -> Place {
    let place = Place::new();
    let leaves = read_rgb(Path::new(LEAVES)).unwrap();
    let (w, h) = (leaves.width() - 20, leaves.height() - 20);
    let part = |x0: usize, y0: usize| Rgb::from_fn(w, h, |x, y| leaves.at(x + x0, y + y0));
    for (name, picture) in [("a_left.png", part(10, 10)), ("a_right.png", part(6, 3))] {
        write_rgb(&place.path().join(name), &picture).unwrap();
    }
    assert_eq!(
        vergence(&place, &["model", "import", LIBSVM, "--name", "test"]).code,
        0
    );
    place
}

/// The page's text without its pictures.
fn page(place: &Place, folder: &str) -> String {
    let whole = std::fs::read_to_string(place.path().join(folder).join("index.html")).unwrap();
    let mut parts = whole.split(";base64,");
    let first = parts.next().unwrap().to_owned();
    parts.fold(first, |text, part| text + &part[part.find('"').unwrap()..])
}

#[test]
fn the_page_of_a_pair_shows_what_is_wrong() {
    let place = place();
    let args = [
        "grade",
        "--left",
        "a_left.png",
        "--right",
        "a_right.png",
        "--model",
        "test",
        "--report",
        "out/page",
    ];
    let done = vergence(&place, &args);
    assert_eq!(done.code, 0, "{done:?}");
    assert!(done.err.contains("wrote out/page/index.html"), "{done:?}");
    let text = page(&place, "out/page");
    // The left picture's content is 7 px higher.
    assert!(text.contains("Vertical offset: \u{2212}7"), "{text}");
    assert!(text.contains(", bad; good up to"));
    for wanted in [
        "Vertical disparity, pixels",
        "Horizontal parallax",
        "Red\u{2013}cyan",
        "0 best \u{2026} 100 worst",
        "the right eye",
    ] {
        assert!(text.contains(wanted), "{wanted} is missing");
    }
    browsed(&place, "out/page", 8);
}

#[test]
fn the_page_of_a_folder_lists_what_failed() {
    let place = place();
    place.file("broken.png", "no picture");
    let done = vergence(
        &place,
        &["grade", ".", "--model", "test", "--report", "page"],
    );
    assert_eq!(done.code, 1, "{done:?}");
    let text = page(&place, "page");
    assert!(text.contains("1 of them not graded"), "{text}");
    assert!(text.contains("broken.png") && text.contains("not a readable picture"));
    browsed(&place, "page", 1);
}

/// Runs in the page once it has been laid out.
const PROBE: &str = "<script>
const found = [];
addEventListener('error', e => found.push('error ' + e.message));
document.addEventListener('securitypolicyviolation', e => found.push('refused ' + e.blockedURI));
addEventListener('load', () => {
  const boxes = s => [...document.querySelectorAll(s)].map(e => e.getBoundingClientRect());
  const gauges = boxes('.gauge svg');
  if (!gauges.every(r => r.width > 80 && r.height > 8)) found.push('a gauge has no size');
  if (![...document.images].every(i => i.naturalWidth > 0)) found.push('a picture is empty');
  if (document.documentElement.scrollWidth > innerWidth + 1) found.push('wider than its window');
  document.title = JSON.stringify({gauges: gauges.length, found});
});
</script></head>";

/// At two widths nothing is amiss, and there are at least so many gauges.
fn browsed(place: &Place, folder: &str, gauges: u64) {
    let path = place.path().join(folder).join("index.html");
    let whole = std::fs::read_to_string(&path).unwrap();
    let probed = whole
        .replacen(
            "default-src 'none'",
            "default-src 'none'; script-src 'unsafe-inline'",
            1,
        )
        .replacen("</head>", PROBE, 1);
    assert!(probed.len() > whole.len() + PROBE.len());
    let copy = place.path().join("probed.html");
    std::fs::write(&copy, probed).unwrap();
    for width in [520, 1280] {
        let output = Command::new("chromium")
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--no-first-run",
                "--hide-scrollbars",
            ])
            .args([
                "--disable-background-networking",
                "--disable-component-update",
                "--virtual-time-budget=3000",
                "--dump-dom",
            ])
            .arg(format!(
                "--user-data-dir={}",
                place.path().join("profile").display()
            ))
            .arg(format!("--window-size={width},900"))
            .arg(format!("file://{}", copy.display()))
            .output();
        let Ok(output) = output else {
            println!("skipped: there is no chromium");
            return;
        };
        let dom = String::from_utf8_lossy(&output.stdout);
        let title = dom
            .split("<title>")
            .nth(1)
            .and_then(|t| t.split("</title>").next())
            .unwrap();
        let answer: serde_json::Value = serde_json::from_str(title).expect("the probe ran");
        assert_eq!(answer["found"], serde_json::json!([]), "at {width}");
        assert!(answer["gauges"].as_u64().unwrap() >= gauges, "{answer}");
    }
}
