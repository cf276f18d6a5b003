//! Cameras that the system knows, by the names that the kernel gives them, and what each says that it can do.

use std::collections::BTreeMap;
use std::path::Path;

use vergence_capture::CaptureError;
use vergence_capture::live::{Abilities, reads_devices};

use super::{Check, Places, Status, abilities, denied, line_of, names};

pub(crate) const GROUP: &str = "cameras";

/// The item under which it is told that there is no camera.
pub(crate) const NONE: &str = "V4L2";

/// Asks a device what it can do; `None` asks nothing.
pub(crate) type Ask<'a> = &'a dyn Fn(&Path) -> Option<Result<Abilities, CaptureError>>;

/// The video nodes by camera. A camera has several (pictures, metadata): they share their device.
pub(crate) fn checks(places: &Places, ask: Ask<'_>) -> Vec<Check> {
    let class = places.sys.join("class/video4linux");
    let mut cameras: BTreeMap<(u32, String), Vec<String>> = BTreeMap::new();
    let mut order: BTreeMap<String, u32> = BTreeMap::new();
    for (place, node) in (0..).zip(names(&class, &["video"])) {
        let device = std::fs::canonicalize(class.join(&node).join("device"))
            .map_or_else(|_| node.clone(), |p| p.to_string_lossy().into_owned());
        let first = *order.entry(device.clone()).or_insert(place);
        cameras.entry((first, device)).or_default().push(node);
    }
    if cameras.is_empty() {
        return vec![
            Check::new(GROUP, NONE, Status::Note, "no camera is connected").next(
                "plug cameras in (`/dev/video0` must appear), or run without: vergence run, vergence run --source files",
            ),
        ];
    }
    cameras
        .into_values()
        .map(|nodes| camera(places, &class, &nodes, ask))
        .collect()
}

/// What is missing for a pair, and what more can be asked of the cameras that were found.
pub(crate) fn further(found: &[Check]) -> Vec<Check> {
    let cameras: Vec<&Check> = found.iter().filter(|c| c.item != NONE).collect();
    let note = |item, found| Check::new(GROUP, item, Status::Note, found);
    let mut checks = Vec::new();
    if cameras.len() == 1 {
        checks.push(note("pair", "one camera is no pair").next(
            "connect a second one of the same type, or use one that gives both eyes side by side",
        ));
    }
    if !reads_devices() && !cameras.is_empty() {
        let found = "what they can do was not asked: this program was built without video devices";
        checks.push(note("abilities", found).next("build it with --features v4l2"));
    }
    let good: Vec<&&Check> = cameras
        .iter()
        .filter(|c| c.status == Status::Good)
        .collect();
    if let (true, [left, right, ..]) = (reads_devices(), &good[..]) {
        checks.push(note("pair", "not looked at as it is now").next(format!(
            "for rates, jitter and skew: vergence doctor --source v4l2 --left {} --right {}",
            left.item, right.item
        )));
    }
    checks
}

fn camera(places: &Places, class: &Path, nodes: &[String], ask: Ask<'_>) -> Check {
    let node = &nodes[0];
    let device = class.join(node).join("device");
    let speed = line_of(&device.join("../speed"));
    let mut found = described(class, nodes, speed.as_deref());
    let path = places.dev.join(node);
    let item = path.display().to_string();
    if let Some(next) = denied(&path, "video") {
        return Check::new(
            GROUP,
            item,
            Status::Wrong,
            format!("{found}: may not be opened by this user"),
        )
        .next(next);
    }
    let answer = asked(places, nodes, ask);
    if let Some(Ok(can)) = &answer {
        found += &format!("; {}", abilities::told(can));
    }
    let slow = speed
        .and_then(|s| s.parse::<f64>().ok())
        .is_some_and(|s| s < 480.0);
    if slow {
        return Check::new(GROUP, item, Status::Wrong, found)
            .next("this is too slow for pictures: use another cable, port or hub");
    }
    match answer {
        Some(Err(error)) => Check::new(GROUP, item, Status::Note, format!("{found}; {error}"))
            .next("take another device where its pictures are wanted"),
        _ => Check::new(GROUP, item, Status::Good, found),
    }
}

/// What the kernel calls a camera, by whom and how it is driven.
fn described(class: &Path, nodes: &[String], speed: Option<&str>) -> String {
    let of = class.join(&nodes[0]);
    let mut found = line_of(&of.join("name")).unwrap_or_else(|| "unnamed".to_owned());
    let driver = std::fs::read_link(of.join("device/driver")).ok();
    if let Some(driver) = driver.as_deref().and_then(Path::file_name) {
        found += &format!(", driver {}", driver.to_string_lossy());
    }
    if let Some(speed) = speed {
        found += &format!(", USB at {speed} Mbit/s");
    }
    if nodes.len() > 1 {
        found += &format!(", also {}", nodes[1..].join(" "));
    }
    found
}

/// The answer of the first node that gives pictures, or why the first one gives none.
fn asked(
    places: &Places,
    nodes: &[String],
    ask: Ask<'_>,
) -> Option<Result<Abilities, CaptureError>> {
    let mut first = None;
    for node in nodes {
        match ask(&places.dev.join(node))? {
            Ok(can) => return Some(Ok(can)),
            Err(error) => first = first.or(Some(error)),
        }
    }
    first.map(Err)
}
