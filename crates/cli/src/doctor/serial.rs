//! Serial ports on which a motion controller could be; none is opened here.

use std::path::PathBuf;

use super::{Check, Places, Status, denied, line_of, names};

const GROUP: &str = "serial ports";

/// One port.
#[derive(Clone, Debug)]
pub(crate) struct SerialPort {
    pub(crate) path: PathBuf,
    /// What the USB device calls itself.
    pub(crate) product: Option<String>,
    /// A name that stays the same when ports are renumbered.
    pub(crate) by_id: Option<PathBuf>,
}

/// All ports of USB adapters and boards, and those on the pins of single-board computers.
pub(crate) fn ports(places: &Places) -> Vec<SerialPort> {
    let by_id = places.dev.join("serial/by-id");
    let links: Vec<(PathBuf, PathBuf)> = names(&by_id, &[""])
        .into_iter()
        .filter_map(|name| {
            let link = by_id.join(name);
            Some((std::fs::canonicalize(&link).ok()?, link))
        })
        .collect();
    names(&places.dev, &["ttyUSB", "ttyACM", "ttyAMA"])
        .into_iter()
        .map(|name| {
            let path = places.dev.join(&name);
            let same = std::fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
            let device = places.sys.join("class/tty").join(&name).join("device");
            // An adapter's port hangs one level below its interface, a board's directly on it.
            let product = ["../product", "../../product"]
                .iter()
                .find_map(|up| line_of(&device.join(up)));
            SerialPort {
                by_id: links
                    .iter()
                    .find(|(to, _)| *to == same)
                    .map(|(_, link)| link.clone()),
                path,
                product,
            }
        })
        .collect()
}

pub(crate) fn checks(ports: &[SerialPort]) -> Vec<Check> {
    if ports.is_empty() {
        return vec![
            Check::new(GROUP, "USB", Status::Note, "no serial port is connected").next(
                "plug a motion controller in (/dev/ttyUSB0 or /dev/ttyACM0 must appear), or use simulated motors",
            ),
        ];
    }
    ports
        .iter()
        .map(|port| {
            let mut found = port.product.clone().unwrap_or_else(|| "unnamed".to_owned());
            if let Some(link) = &port.by_id {
                found += &format!(", always at {}", link.display());
            }
            let item = port.path.display().to_string();
            match denied(&port.path, "dialout") {
                Some(next) => Check::new(
                    GROUP,
                    item,
                    Status::Wrong,
                    format!("{found}: may not be opened by this user"),
                )
                .next(next),
                None => Check::new(GROUP, item, Status::Good, found),
            }
        })
        .collect()
}
