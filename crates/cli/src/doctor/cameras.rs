//! Cameras that the system knows, by the names that the kernel gives them; none is opened.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Check, Places, Status, denied, line_of, names};

const GROUP: &str = "cameras";

/// The video nodes by camera. A camera has several (pictures, metadata): they share their device.
pub(crate) fn checks(places: &Places) -> Vec<Check> {
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
            Check::new(GROUP, "V4L2", Status::Note, "no camera is connected").next(
                "plug cameras in (`/dev/video0` must appear), or run without: vergence run, vergence run --source files",
            ),
        ];
    }
    let count = cameras.len();
    let mut checks: Vec<Check> = cameras
        .into_values()
        .map(|nodes| camera(places, &class, &nodes))
        .collect();
    if count == 1 {
        checks.push(
            Check::new(GROUP, "pair", Status::Note, "one camera is no pair").next(
                "connect a second one of the same type, or use one that gives both eyes side by side",
            ),
        );
    }
    checks
}

fn camera(places: &Places, class: &Path, nodes: &[String]) -> Check {
    let node = &nodes[0];
    let name = line_of(&class.join(node).join("name")).unwrap_or_else(|| "unnamed".to_owned());
    let device = class.join(node).join("device");
    let driver = std::fs::read_link(device.join("driver"));
    let driver = driver
        .ok()
        .and_then(|p| Some(p.file_name()?.to_string_lossy().into_owned()));
    let speed = line_of(&device.join("../speed"));
    let mut found = name;
    if let Some(driver) = driver {
        found += &format!(", driver {driver}");
    }
    if let Some(speed) = &speed {
        found += &format!(", USB at {speed} Mbit/s");
    }
    if nodes.len() > 1 {
        found += &format!(", also {}", nodes[1..].join(" "));
    }
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
    let slow = speed
        .and_then(|s| s.parse::<f64>().ok())
        .is_some_and(|s| s < 480.0);
    if slow {
        return Check::new(GROUP, item, Status::Wrong, found)
            .next("this is too slow for pictures: use another cable, port or hub");
    }
    Check::new(GROUP, item, Status::Good, found)
}
