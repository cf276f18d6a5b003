//! Settings as a person or a program reads them.

use serde_json::{Map, json};

use super::keys::{self, Key, Kind, Range};
use super::quantity::Dimension;
use super::{Entry, Origin, Settings, Value};

/// The value as it would be typed, without quotes.
pub(super) fn value_text(entry: &Entry) -> String {
    match &entry.value {
        Value::Auto => "auto".to_owned(),
        Value::Switch(on) => on.to_string(),
        Value::Word(word) => word.clone(),
        Value::Number(number) => match dimension(entry.key) {
            Some(d) => d.format(*number, like(entry.key)),
            None => format!("{number}"),
        },
    }
}

/// A text that carries the unit in which a key is printed.
fn like(key: &Key) -> &str {
    match key.kind {
        Kind::QuantityOrAuto(Dimension::Number) => "1",
        Kind::QuantityOrAuto(Dimension::Length) => "1 m",
        Kind::QuantityOrAuto(Dimension::Time) => "1 s",
        _ => key.default,
    }
}

fn dimension(key: &Key) -> Option<Dimension> {
    match key.kind {
        Kind::Quantity(d) | Kind::QuantityOrAuto(d) => Some(d),
        Kind::Count => Some(Dimension::Number),
        Kind::Choice(_) | Kind::Switch | Kind::Text => None,
    }
}

/// The settings as a file that reads back as the same settings.
pub(super) fn toml(settings: &Settings) -> String {
    let mut text = String::from(
        "# Settings of vergence: every key with its value, meaning and default.\n\
         # Lengths take m, mm, cm, um, in (a bare number: m); angles deg, rad, mrad, arcmin, arcsec (a bare number: deg);\n\
         # times s, ms, us, min (a bare number: s); fractions 0.02 or \"2%\".\n\
         # Precedence: flags, then VERGENCE_<SECTION>_<KEY> in the environment, then this file, then defaults.\n",
    );
    for (section, about) in keys::SECTIONS {
        text += &format!("\n# {about}\n[{section}]\n");
        for entry in settings
            .entries()
            .iter()
            .filter(|e| e.key.section == *section)
        {
            text += &format!("# {}\n# {}\n", entry.key.meaning, facts(entry.key));
            if follows_from_width(settings, entry.key) {
                text += "# (follows from width) ";
            }
            text += &format!("{} = {}", entry.key.name, toml_value(entry));
            if entry.origin != Origin::Default {
                text += &format!("  # from {}", one_line(&entry.origin.to_string()));
            }
            text += "\n";
        }
    }
    text
}

/// The settings alone, without comments and without where they come from: the same settings, the same text. Where a run's folder was made is left out.
pub(super) fn bare_toml(settings: &Settings) -> String {
    let mut text = String::new();
    for (section, _) in keys::SECTIONS {
        text += &format!("[{section}]\n");
        for entry in settings.entries().iter().filter(|e| {
            e.key.section == *section
                && e.key.path() != "run.out"
                && !follows_from_width(settings, e.key)
        }) {
            text += &format!("{} = {}\n", entry.key.name, toml_value(entry));
        }
    }
    text
}

/// Whether this is the magnification and the width of the screen decides it.
fn follows_from_width(settings: &Settings, key: &Key) -> bool {
    key.path() == "screen.magnification" && settings.number_or_auto("screen.width").is_some()
}

/// Kind, range and default in one line.
fn facts(key: &Key) -> String {
    let kind = match key.kind {
        Kind::Quantity(d) => d.noun().to_owned(),
        Kind::QuantityOrAuto(d) => format!("{} or auto", d.noun()),
        Kind::Count => "whole number".to_owned(),
        Kind::Choice(words) => format!("one of {}", words.join(", ")),
        Kind::Switch => "true or false".to_owned(),
        Kind::Text => "text".to_owned(),
    };
    let range = match (key.range, dimension(key)) {
        (Range::Positive, _) => ", more than 0".to_owned(),
        (Range::FromZero, _) => ", 0 or more".to_owned(),
        (Range::Within(low, high), Some(d)) => {
            format!(
                ", from {} to {}",
                d.format(low, like(key)),
                d.format(high, like(key))
            )
        }
        (Range::ZeroOrWithin(low, high), Some(d)) => {
            format!(
                ", 0 or from {} to {}",
                d.format(low, like(key)),
                d.format(high, like(key))
            )
        }
        _ => String::new(),
    };
    format!("({kind}{range}; default {})", key.default)
}

fn toml_value(entry: &Entry) -> String {
    let text = value_text(entry);
    let bare = matches!(
        entry.key.kind,
        Kind::Switch | Kind::Count | Kind::Quantity(Dimension::Number)
    );
    if bare { text } else { quoted(&text) }
}

/// A TOML basic string.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// A comment must not break out of its line, whatever a path is called.
fn one_line(text: &str) -> String {
    text.chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect()
}

/// The settings as a tree of objects.
pub(super) fn json(settings: &Settings) -> serde_json::Value {
    let mut root = Map::new();
    for (section, _) in keys::SECTIONS {
        let mut keys = Map::new();
        for entry in settings
            .entries()
            .iter()
            .filter(|e| e.key.section == *section)
        {
            keys.insert(entry.key.name.to_owned(), entry_json(entry));
        }
        insert_nested(&mut root, section, keys);
    }
    json!({ "settings": root })
}

fn insert_nested(
    root: &mut Map<String, serde_json::Value>,
    section: &str,
    keys: Map<String, serde_json::Value>,
) {
    match section.split_once('.') {
        None => {
            root.insert(section.to_owned(), keys.into());
        }
        Some((outer, inner)) => {
            let slot = root.entry(outer).or_insert_with(|| json!({}));
            if let Some(object) = slot.as_object_mut() {
                object.insert(inner.to_owned(), keys.into());
            }
        }
    }
}

fn entry_json(entry: &Entry) -> serde_json::Value {
    let value = match &entry.value {
        Value::Auto => serde_json::Value::Null,
        Value::Number(n) if entry.key.kind == Kind::Count => json!(*n as u64),
        Value::Number(n) => json!(n),
        Value::Word(word) => json!(word),
        Value::Switch(on) => json!(on),
    };
    let origin = match &entry.origin {
        Origin::Default => "default",
        Origin::File { .. } => "file",
        Origin::Environment(_) => "environment",
        Origin::Flag(_) => "flag",
    };
    json!({
        "value": value,
        "unit": dimension(entry.key).map_or("", Dimension::inner_unit),
        "text": value_text(entry),
        "origin": origin,
        "origin_detail": entry.origin.to_string(),
        "default": entry.key.default,
        "meaning": entry.key.meaning,
    })
}
