//! Finds a target in pictures: `cargo run --release -p vergence-calib --example detect -- TARGET PICTURE...` prints one JSON
//! object with the corners `[id, u, v, sigma]` of every picture, and times (fastest of five) with `--times`.

use std::path::Path;
use std::time::Instant;

use vergence_calib::{Target, detect};
use vergence_imaging::files::read_gray;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words: Vec<String> = std::env::args().skip(1).collect();
    let times = words.iter().any(|w| w == "--times");
    words.retain(|w| w != "--times");
    let (target, files) = words
        .split_first()
        .ok_or("usage: detect TARGET PICTURE...")?;
    let target = Target::parse(target)?;
    let mut all = serde_json::Map::new();
    for file in files {
        let picture = read_gray(Path::new(file))?;
        let mut fastest = f64::INFINITY;
        let mut found = None;
        for _ in 0..if times { 5 } else { 1 } {
            let begin = Instant::now();
            found = Some(detect(&picture, &target));
            fastest = fastest.min(begin.elapsed().as_secs_f64());
        }
        let name = Path::new(file)
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let Some(found) = found else { continue };
        match &found {
            Ok(d) => eprintln!(
                "{name}: {} corners, mirrored {}, {:.2} ms",
                d.corners.len(),
                d.mirrored,
                1e3 * fastest
            ),
            Err(e) => eprintln!("{name}: {e} ({:.2} ms)", 1e3 * fastest),
        }
        let corners: Vec<_> = (found.iter().flat_map(|d| &d.corners))
            .map(|c| (c.id, c.pixel.x, c.pixel.y, c.sigma_px))
            .collect();
        all.insert(name, serde_json::json!(corners));
    }
    println!("{}", serde_json::Value::Object(all));
    Ok(())
}
