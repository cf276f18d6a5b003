//! Proves of the page, in a real browser (Debian's chromium, headless; said to be skipped where there is none): every gauge, drawing and picture
//! is there with a size, nothing runs off a phone's screen, no error is raised and no request leaves; and of its text: names from outside are escaped,
//! every table has headings, every picture a text, long sequences stay small. The data are made up; that they are measured right is proved elsewhere.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;
use vergence_geometry::comfort::Viewing;
use vergence_geometry::viewing::Viewer;
use vergence_quality::Score;

use super::*;

/// A hill of texture, seen from the left or the right.
fn picture(shift: f64) -> Rgb {
    Rgb::from_fn(1200, 800, |x, y| {
        let (u, v) = (x as f64 + shift, y as f64);
        let hill = (-((u - 600.0) / 220.0).powi(2) - ((v - 420.0) / 180.0).powi(2)).exp();
        let u = u + 14.0 * shift.signum() * hill;
        let wave = (u / 17.0).sin() * (v / 23.0).cos() + (u / 5.1 + v / 7.3).sin() * 0.4;
        let light = 120.0 + 60.0 * wave + 50.0 * hill;
        [light, 0.8 * light + 20.0, 200.0 - 0.5 * light].map(|v| v.clamp(0.0, 255.0) as u8)
    })
}

fn judged(name: &str, value: f64, unit: &str, limits: [f64; 2], verdict: Verdict) -> Judged {
    Judged {
        name: name.to_owned(),
        value,
        sigma: Some(0.1 * value.abs() + 0.01),
        unit: unit.to_owned(),
        look: limits[0],
        bad: limits[1],
        source: "Author 2011, Table 3".to_owned(),
        verdict,
        meaning: format!("{name}: move the right picture by so much to take it away"),
    }
}

fn scored(name: &str, score: f64) -> NamedScore {
    NamedScore {
        name: name.to_owned(),
        score: Ok(Score {
            score,
            class_probabilities: [0.1, 0.15, 0.05, 0.6, 0.1],
            regression_scores: [score; 5],
        }),
        limits: Some([35.0, 55.0]),
    }
}

/// A pair with everything, named by somebody hostile.
fn pair() -> ReportData {
    let at = |i: usize| {
        let (x, y) = ((i * 53 % 1200) as f64, (i * 31 % 800) as f64);
        let dy = 1.2 + 0.002 * (x - 600.0) + 0.3 * (i as f64).sin();
        [x, y, dy]
    };
    let mut data = ReportData::new("<script>alert(1)</script> & \"pair\" 0001.mpo");
    data.facts = vec![
        ("Size".to_owned(), "1200 \u{d7} 800 px each".to_owned()),
        (
            "Layout".to_owned(),
            "side by side (its content says so)".to_owned(),
        ),
        ("Model".to_owned(), "default".to_owned()),
        (
            "Screen".to_owned(),
            "60 cm wide, seen from 0.7 m".to_owned(),
        ),
    ];
    data.remarks = vec!["the file names no layout".to_owned()];
    data.verdict = Some(Verdict::Bad);
    data.pictures = Pictures::Pair {
        left: picture(6.0),
        right: picture(-6.0),
    };
    data.scores = vec![
        scored("left", 22.4),
        scored("right", 47.9),
        scored("worse eye", 47.9),
        scored("fused", 61.0),
        NamedScore {
            name: "difference".to_owned(),
            score: Err("the difference is constant".to_owned()),
            limits: None,
        },
    ];
    data.causes = vec![
        judged("Vertical offset", 1.21, "px", [0.5, 1.0], Verdict::Bad),
        judged("Roll", -0.115, "deg", [0.1, 0.3], Verdict::Look),
        judged("Zoom", 0.02, "%", [0.2, 0.5], Verdict::Good),
        judged(
            "Eyes swapped",
            0.0,
            "probability",
            [0.5, 0.5],
            Verdict::Good,
        ),
        judged("Parallax near", -1.8, "%", [1.0, 2.5], Verdict::Look),
        judged("Colour", f64::NAN, "\u{394}E", [2.0, 5.0], Verdict::Good),
        judged("Window violation", 12.0, "%", [2.0, 10.0], Verdict::Bad),
    ];
    data.not_judged = vec![(
        "time offset".to_owned(),
        "it takes a sequence with motion".to_owned(),
    )];
    data.vertical = Some(VerticalMap {
        size_px: [1200, 800],
        samples: (0..900).map(at).collect(),
        residuals: (0..900)
            .map(|i| [at(i)[0], at(i)[1], 0.3 * (i as f64).sin()])
            .collect(),
    });
    data.parallax = Some(ParallaxSamples {
        percent: (0..900)
            .map(|i| 1.6 * (f64::from(i) * 0.7).sin() + 0.6 * (f64::from(i) * 0.13).cos())
            .collect(),
        viewing: Viewing {
            viewer: Viewer::default(),
            screen_width_m: 0.6,
            width_px: 1200,
        },
    });
    let strip = |edge, share| WindowStrip {
        edge,
        share,
        nearest_percent: 3.0 * share,
        mask_px: 20.0 * share,
    };
    data.window = vec![
        strip(Edge::Left, 0.42),
        strip(Edge::Right, 0.0),
        strip(Edge::Top, 0.1),
        strip(Edge::Bottom, 0.3),
    ];
    data
}

/// So many frames of a film.
fn film(frames: usize) -> ReportData {
    let mut data = ReportData::new("a film.mp4");
    data.verdict = Some(Verdict::Look);
    let item = |i: usize| TimeItem {
        at: i as f64 * 0.5,
        name: format!("frame {i} <b>"),
        score: (i % 50 != 7).then(|| 30.0 + 20.0 * (i as f64 / 9.0).sin()),
        verdict: Some(if i.is_multiple_of(9) {
            Verdict::Bad
        } else {
            Verdict::Good
        }),
        measures: vec![
            Some((i as f64 / 30.0).cos()),
            (!i.is_multiple_of(3)).then_some(0.1),
        ],
        failure: (i % 50 == 7).then(|| "its data break off".to_owned()),
    };
    let line = TimeLine {
        name: "a film.mp4".to_owned(),
        axis: "time / s".to_owned(),
        ordered: true,
        limits: [35.0, 55.0],
        measures: vec![
            "vertical offset / px".to_owned(),
            "nearest parallax / %".to_owned(),
        ],
        items: (0..frames).map(item).collect(),
        cuts: vec![12.0, 31.5, 44.0],
        whole: Vec::new(),
    };
    let mut counts = Counts::default();
    line.items.iter().for_each(|i| counts.take(i.verdict));
    data.counts = Some(counts);
    data.time_lines = vec![line];
    data
}

/// Text of the page without the pictures, to look for things in.
fn text_of(page: &str) -> String {
    let mut parts = page.split("data:image/jpeg;base64,");
    let first = parts.next().unwrap_or("").to_owned();
    parts.fold(first, |text, part| {
        let end = part.find('"').unwrap_or(0);
        text + &part[end..]
    })
}

#[test]
fn the_page_is_complete_escaped_and_small() {
    for (data, most) in [
        (pair(), 2 << 20),
        (film(40), 200 << 10),
        (film(200_000), 400 << 10),
    ] {
        let page = page::html(&data).unwrap();
        assert!(page.len() < most, "{} bytes", page.len());
        let text = text_of(&page);
        assert!(
            !text.contains("<script") && !text.contains("<b>") && !text.contains("NaN"),
            "{text}"
        );
        for outside in [
            "http:", "https:", "url(//", "@import", "src=\"/", "href=\"/",
        ] {
            let found = text.matches(outside).count();
            let names = text.matches("xmlns=\"http:").count();
            assert_eq!(
                found,
                if outside == "http:" { names } else { 0 },
                "{outside}"
            );
        }
        assert_eq!(
            text.matches("<table").count(),
            text.matches("<thead>").count()
        );
        assert_eq!(
            text.matches("<img").count(),
            text.matches(" alt=\"").count()
        );
        assert!(text.contains("0 best \u{2026} 100 worst"));
    }
    let text = text_of(&page::html(&pair()).unwrap());
    for wanted in [
        "&lt;script&gt;alert(1)",
        "Vertical offset: 1.21 px, bad; good up to 0.5, bad beyond 1",
        "Author 2011, Table 3",
        "1 degree of disparity",
        "BSkyB",
        "the difference is constant",
    ] {
        assert!(text.contains(wanted), "{wanted} is missing");
    }
    // A report of nothing is a page too.
    let nothing = page::html(&ReportData::new("")).unwrap();
    assert!(nothing.contains("not judged") && nothing.len() < 30 << 10);
}

#[test]
fn a_report_is_whole_or_not_there() {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join("a/b");
    let path = write_report(&dir, &film(3)).unwrap();
    assert_eq!(path, dir.join("index.html"));
    assert_eq!(fs::read_dir(&dir).unwrap().count(), 1);
    let taken = root.path().join("file");
    fs::write(&taken, "x").unwrap();
    assert!(write_report(&taken, &film(3)).is_err());
}

/// What the browser finds, run after the page has been laid out.
const PROBE: &str = "<script>
const found = {errors: [], refused: []};
addEventListener('error', e => found.errors.push(String(e.message)));
document.addEventListener('securitypolicyviolation', e => found.refused.push(e.blockedURI));
addEventListener('load', () => {
  const sizes = s => [...document.querySelectorAll(s)].map(e => { const r = e.getBoundingClientRect(); return [r.width, r.height]; });
  found.gauges = sizes('.gauge svg');
  found.needles = sizes('.needle');
  found.figures = sizes('figure svg, .wide svg, .narrow svg').filter(s => s[0] > 0);
  found.loaded = [...document.images].every(i => i.complete && i.naturalWidth > 0);
  found.shown = sizes('img').filter(s => s[0] > 0).length;
  found.width = innerWidth;
  found.scroll = document.documentElement.scrollWidth;
  found.views = ['glasses', 'blink', 'differ', 'both'].map(v => {
    document.getElementById('view-' + v)?.click();
    return [...document.querySelectorAll('.view')].filter(e => e.getBoundingClientRect().height > 0).map(e => e.className).join();
  });
  const pre = document.createElement('pre');
  pre.id = 'probe';
  pre.textContent = JSON.stringify(found);
  document.body.append(pre);
});
</script></head>";

fn chromium() -> Option<&'static str> {
    let found = ["chromium", "chromium-browser", "google-chrome"]
        .into_iter()
        .find(|name| Command::new(name).arg("--version").output().is_ok());
    if found.is_none() {
        println!("skipped: there is no chromium");
    }
    found
}

/// The browser's answer to arguments and a page.
fn browse(browser: &str, folder: &Path, page: &Path, width: u32, more: &[&str]) -> String {
    let profile = folder.join("profile");
    let output = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--no-first-run",
        ])
        .args([
            "--disable-background-networking",
            "--disable-component-update",
            "--virtual-time-budget=3000",
            "--hide-scrollbars",
        ])
        .arg(format!("--user-data-dir={}", profile.display()))
        .arg(format!("--window-size={width},900"))
        .args(more)
        .arg(format!("file://{}", page.display()))
        .output()
        .unwrap();
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The page with the probe in it; its policy lets that one script run.
fn probed(page: &str) -> String {
    assert!(page.contains("default-src 'none'"));
    page.replacen(
        "default-src 'none'",
        "default-src 'none'; script-src 'unsafe-inline'",
        1,
    )
    .replacen("</head>", PROBE, 1)
}

/// What the probe found.
fn answer(dom: &str) -> Value {
    let from = dom.find("<pre id=\"probe\">").map(|at| at + 16);
    let from = from.unwrap_or_else(|| panic!("the page was not laid out: {dom:.400}"));
    let text = &dom[from..from + dom[from..].find("</pre>").unwrap()];
    serde_json::from_str(
        &text
            .replace("&amp;", "&")
            .replace("&lt;", "<")
            .replace("&gt;", ">"),
    )
    .unwrap()
}

fn sizes(found: &Value, key: &str) -> Vec<[f64; 2]> {
    serde_json::from_value(found[key].clone()).unwrap()
}

#[test]
fn a_browser_lays_the_page_out() {
    let Some(browser) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    // Where a person wants to look: VERGENCE_TEST_PAGES=folder keeps the pages.
    let kept = std::env::var_os("VERGENCE_TEST_PAGES").map(PathBuf::from);
    for (name, data, gauges) in [("pair", pair(), 11), ("film", film(120), 0)] {
        let page = page::html(&data).unwrap();
        if let Some(kept) = &kept {
            fs::write(kept.join(format!("{name}.html")), &page).unwrap();
        }
        let path = folder.path().join(format!("{name}.html"));
        fs::write(&path, probed(&page)).unwrap();
        // Windows of a browser are no narrower than this; a phone is tried in a frame.
        for width in [1280, 520] {
            let dom = browse(browser, folder.path(), &path, width, &["--dump-dom"]);
            let found = answer(&dom);
            assert_eq!(found["errors"], serde_json::json!([]), "{name}");
            assert_eq!(found["refused"], serde_json::json!([]), "{name}");
            let drawn = sizes(&found, "gauges");
            assert_eq!(drawn.len(), gauges, "{name}");
            assert!(
                drawn.iter().all(|[w, h]| *w > 80.0 && *h > 8.0),
                "{name} {width}: {drawn:?}"
            );
            let needles = sizes(&found, "needles");
            // One value is unknown and has none.
            assert_eq!(needles.len(), gauges.saturating_sub(1), "{name}");
            assert!(
                needles.iter().all(|[w, h]| *w > 0.5 && *h > 8.0),
                "{needles:?}"
            );
            let figures = sizes(&found, "figures");
            assert!(
                figures.iter().all(|[w, h]| *w > 200.0 && *h > 50.0),
                "{name} {width}: {figures:?}"
            );
            assert_eq!(found["loaded"], true, "{name}");
            let (inner, scroll) = (
                found["width"].as_f64().unwrap(),
                found["scroll"].as_f64().unwrap(),
            );
            assert!(scroll <= inner + 1.0, "{name} is {scroll} wide in {inner}");
            if name == "pair" {
                assert_eq!(found["shown"], 2, "side by side is what is seen first");
                let views =
                    serde_json::json!(["view glasses", "view blink", "view differ", "view both"]);
                assert_eq!(found["views"], views);
            }
        }
    }
}
