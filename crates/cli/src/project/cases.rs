//! Files of cases, each with its own rig.

use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;
use vergence_geometry::GeometryError;
use vergence_geometry::cases::{Answer, ArrayCase, Case, CaseReport};

use super::FILE_LIMIT_BYTES;
use crate::fault;
use crate::output;
use crate::settings::nearest;

/// Read the file, answer every case in order, print the answers as JSON.
pub(super) fn run(path: &Path) -> anyhow::Result<()> {
    let text = output::read_text(path, "file of cases", FILE_LIMIT_BYTES)?;
    let at = |message: String| fault::usage(format!("file of cases {}: {message}", path.display()));
    let root: Value = serde_json::from_str(&text).map_err(|e| at(format!("not JSON: {e}")))?;
    let Some(root) = root.as_object() else {
        return Err(at("holds no object".to_owned())
            .hint("the file is {\"cases\": [...], \"arrays\": [...]}")
            .into());
    };
    if !root.contains_key("cases") && !root.contains_key("arrays") {
        return Err(at("has neither \"cases\" nor \"arrays\"".to_owned()).into());
    }
    let report = CaseReport {
        cases: answers(root.get("cases"), "case", Case::evaluate).map_err(&at)?,
        arrays: answers(root.get("arrays"), "array", ArrayCase::evaluate).map_err(&at)?,
    };
    output::print_json(&report)
}

/// Fields that a case may have; what is not needed to compute it is passed over, anything else may be mistyped.
const FIELDS: &[&str] = &[
    "id", "mode", "t", "f", "M", "e", "V", "L", "target", "pupil", "n", "x0", "y0", "z0", "expect",
    "near", "note", "result", "picture",
];

fn check_fields(case: &Value) -> Result<(), String> {
    let unknown = case
        .as_object()
        .and_then(|fields| fields.keys().find(|k| !FIELDS.contains(&k.as_str())));
    match unknown {
        None => Ok(()),
        Some(name) => {
            let near = nearest(name, FIELDS.iter().copied()).unwrap_or_default();
            Err(format!(
                "unknown field \"{name}\"; the nearest is \"{near}\""
            ))
        }
    }
}

/// The answers of one list; the error names the case.
fn answers<C: DeserializeOwned, R>(
    list: Option<&Value>,
    what: &str,
    evaluate: impl Fn(&C) -> Result<R, GeometryError>,
) -> Result<Vec<Answer<R>>, String> {
    let list = match list {
        None => return Ok(Vec::new()),
        Some(Value::Array(list)) => list,
        Some(_) => return Err(format!("\"{what}s\" is no list")),
    };
    list.iter()
        .enumerate()
        .map(|(i, value)| {
            let id = match value.get("id") {
                Some(Value::String(id)) => id.clone(),
                Some(_) => return Err(format!("the id of {what} number {} is no text", i + 1)),
                None => return Err(format!("{what} number {} has no id", i + 1)),
            };
            check_fields(value).map_err(|e| format!("{what} {id}: {e}"))?;
            let case = C::deserialize(value).map_err(|e| format!("{what} {id}: {e}"))?;
            let result = evaluate(&case).map_err(|e| format!("{what} {id}: {e}"))?;
            Ok(Answer { id, result })
        })
        .collect()
}
