//! Results as a table of comma-separated values (RFC 4180), one row an item.

use serde_json::Value;
use vergence_quality::FEATURE_COUNT;

use super::record::Record;

/// Columns: name, and where the value stands in the record's JSON. The first that is there counts.
const COLUMNS: [(&str, &[&str]); 32] = [
    ("item", &["/item"]),
    ("kind", &["/kind"]),
    ("time_s", &["/time_s"]),
    ("width_px", &["/size_px/0"]),
    ("height_px", &["/size_px/1"]),
    ("layout", &["/layout/name"]),
    ("model", &["/model"]),
    ("score", &["/worse/score", "/score/worst", "/score"]),
    ("verdict", &["/verdict"]),
    ("jp2k", &["/class_probabilities/jp2k"]),
    ("jpeg", &["/class_probabilities/jpeg"]),
    ("wn", &["/class_probabilities/wn"]),
    ("blur", &["/class_probabilities/blur"]),
    ("ff", &["/class_probabilities/ff"]),
    ("left", &["/left/score"]),
    ("right", &["/right/score"]),
    ("difference", &["/difference/score"]),
    ("fused", &["/fused/score"]),
    ("near_percent", &["/parallax/near/percent"]),
    ("far_percent", &["/parallax/far/percent"]),
    ("near_arcmin", &["/parallax/near/arcmin"]),
    ("far_arcmin", &["/parallax/far/arcmin"]),
    ("offset_px", &["/vertical/offset_px"]),
    ("roll_deg", &["/vertical/roll_deg"]),
    ("zoom_percent", &["/vertical/zoom_percent"]),
    ("keystone_px", &["/vertical/keystone_px"]),
    ("swapped", &["/swapped"]),
    ("gain", &["/gain"]),
    ("blur_sigma_px", &["/blur_sigma_px"]),
    ("time_offset_frames", &["/time_offset_frames"]),
    ("matches", &["/matches/points"]),
    ("error", &["/error"]),
];

/// The names of the columns.
pub(super) fn header(features: bool) -> String {
    let names = COLUMNS.iter().map(|(name, _)| (*name).to_owned());
    let listed = (1..=FEATURE_COUNT)
        .filter(|_| features)
        .map(|i| format!("f{i}"));
    line(names.chain(listed))
}

/// One record. Features are those of single pictures.
pub(super) fn row(record: &Record, features: bool) -> serde_json::Result<String> {
    let value = serde_json::to_value(record)?;
    let cells = COLUMNS.iter().map(|(_, places)| {
        let found = places.iter().find_map(|place| value.pointer(place));
        // A score is a number in pictures and an object in sequences.
        found.filter(|v| !v.is_object()).map_or(String::new(), cell)
    });
    let listed = (0..FEATURE_COUNT).filter(|_| features).map(|i| {
        let feature = value.pointer(&format!("/features/{i}"));
        feature.map_or(String::new(), cell)
    });
    Ok(line(cells.chain(listed)))
}

fn cell(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn line(cells: impl Iterator<Item = String>) -> String {
    let quoted = cells.map(|cell| {
        if cell.contains([',', '"', '\n', '\r']) {
            format!("\"{}\"", cell.replace('"', "\"\""))
        } else {
            cell
        }
    });
    let mut line = quoted.collect::<Vec<_>>().join(",");
    line.push('\n');
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What would break a row stands in quotes.
    #[test]
    fn cells_are_quoted() {
        let cells = ["a", "b,c", "say \"x\"", ""].map(str::to_owned);
        assert_eq!(line(cells.into_iter()), "a,\"b,c\",\"say \"\"x\"\"\",\n");
        assert!(header(true).contains("error,f1,f2,") && header(true).ends_with(",f87,f88\n"));
    }
}
