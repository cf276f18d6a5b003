//! The settings of the program: flags over environment over file over defaults.
//!
//! [`keys`] holds one table of all keys; this module fills it from the four layers and remembers where each value came
//! from. A value is checked the moment it is read, so what the getters return is in range.

pub(crate) mod keys;
mod nearest;
mod print;
pub(crate) mod quantity;

use std::fmt;
use std::path::{Path, PathBuf};

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::fault::{self, Fault};
use crate::output;
use keys::{Key, Kind, Range};
pub(crate) use nearest::nearest;
use quantity::Dimension;

/// A settings file larger than this is a mistake.
const FILE_LIMIT_BYTES: u64 = 1 << 20;

/// A checked value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    /// SI units and radians.
    Number(f64),
    /// A word or a text.
    Word(String),
    /// On or off.
    Switch(bool),
    /// Left to the program.
    Auto,
}

/// Where a value came from; later variants win.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Origin {
    /// The table of keys.
    Default,
    /// The settings file.
    File {
        /// Its path as given.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
    },
    /// An environment variable of this name.
    Environment(String),
    /// A flag as typed, `--base`.
    Flag(String),
}

impl Origin {
    /// Rank in the precedence; higher wins.
    fn rank(&self) -> u8 {
        match self {
            Origin::Default => 0,
            Origin::File { .. } => 1,
            Origin::Environment(_) => 2,
            Origin::Flag(_) => 3,
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Origin::Default => f.write_str("default"),
            Origin::File { path, line } => write!(f, "{} line {line}", path.display()),
            Origin::Environment(name) => write!(f, "environment {name}"),
            Origin::Flag(flag) => f.write_str(flag),
        }
    }
}

/// One key with its value.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    /// The row of the table.
    pub(crate) key: &'static Key,
    /// Its value.
    pub(crate) value: Value,
    /// Where that came from.
    pub(crate) origin: Origin,
}

/// A value that a flag sets: `("rig.interaxial", "--base", "65mm")`.
#[derive(Clone, Debug)]
pub(crate) struct Override {
    /// `section.name`.
    pub(crate) path: String,
    /// The flag as a person types it.
    pub(crate) flag: String,
    /// What was typed.
    pub(crate) text: String,
}

/// All keys with their values, in the order of the table.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    entries: Vec<Entry>,
}

impl Settings {
    /// Defaults, then the file if there is one, then `VERGENCE_<SECTION>_<KEY>` of the environment, then flags.
    pub(crate) fn load(
        file: Option<&Path>,
        environment: impl IntoIterator<Item = (String, String)>,
        flags: &[Override],
    ) -> anyhow::Result<Self> {
        let mut settings = Self::defaults()?;
        if let Some(path) = file {
            let text = output::read_text(path, "settings file", FILE_LIMIT_BYTES)?;
            settings.apply_file(path, &text)?;
        }
        settings.apply_environment(environment)?;
        for flag in flags {
            settings.apply_flag(flag)?;
        }
        settings.check_together()?;
        Ok(settings)
    }

    /// Defaults, then the settings that a recording holds. The person's file of waypoints is not in it, and no walk is needed.
    pub(crate) fn from_recording(path: &Path, text: &str) -> anyhow::Result<Self> {
        let mut settings = Self::defaults()?;
        settings
            .apply_file(&path.join("settings.toml"), text)
            .map_err(|e| e.hint("the recording may be of another version of the program"))?;
        settings.set("run.path", Value::Word("walk".to_owned()), Origin::Default);
        settings.check_together()?;
        Ok(settings)
    }

    fn defaults() -> anyhow::Result<Self> {
        let entries = keys::all()
            .map(|key| {
                let value = parse(key, key.default)
                    .map_err(|why| fault::failed(format!("default of {} {why}", key.path())))?;
                Ok(Entry {
                    key,
                    value,
                    origin: Origin::Default,
                })
            })
            .collect::<Result<_, Fault>>()?;
        Ok(Self { entries })
    }

    /// All entries in the order of the table.
    pub(crate) fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// The entry of `section.name`; asking for a key that is not in the table is a bug.
    pub(crate) fn entry(&self, path: &str) -> &Entry {
        match self.entries.iter().find(|e| e.key.path() == path) {
            Some(entry) => entry,
            None => panic!("no setting is called {path}"),
        }
    }

    /// A number in SI units and radians. Asking for a key of another kind is a bug.
    pub(crate) fn number(&self, path: &str) -> f64 {
        match self.entry(path).value {
            Value::Number(number) => number,
            ref other => panic!("setting {path} is no number but {other:?}"),
        }
    }

    /// A number, or `None` for `auto`.
    pub(crate) fn number_or_auto(&self, path: &str) -> Option<f64> {
        match self.entry(path).value {
            Value::Auto => None,
            _ => Some(self.number(path)),
        }
    }

    /// A whole number.
    pub(crate) fn count(&self, path: &str) -> usize {
        self.number(path) as usize
    }

    /// On or off.
    pub(crate) fn switch(&self, path: &str) -> bool {
        self.entry(path).value == Value::Switch(true)
    }

    /// A word or a text.
    pub(crate) fn word(&self, path: &str) -> &str {
        match &self.entry(path).value {
            Value::Word(word) => word,
            other => panic!("setting {path} is no word but {other:?}"),
        }
    }

    fn set(&mut self, path: &str, value: Value, origin: Origin) {
        if let Some(entry) = self.entries.iter_mut().find(|e| e.key.path() == path) {
            entry.value = value;
            entry.origin = origin;
        }
    }

    fn apply_flag(&mut self, flag: &Override) -> Result<(), Fault> {
        let Some(key) = keys::all().find(|k| k.path() == flag.path) else {
            return Err(unknown_path(&flag.path).context(&flag.flag));
        };
        let value = parse(key, &flag.text)
            .map_err(|why| fault::usage(format!("{} '{}' {why}", flag.flag, flag.text)))?;
        self.set(&flag.path, value, Origin::Flag(flag.flag.clone()));
        Ok(())
    }

    fn apply_environment(
        &mut self,
        environment: impl IntoIterator<Item = (String, String)>,
    ) -> Result<(), Fault> {
        // Sorted, so that of several mistakes always the same one is told.
        let mut variables: Vec<_> = environment
            .into_iter()
            .filter(|(name, _)| names_a_section(name))
            .collect();
        variables.sort();
        for (name, text) in variables {
            let Some(key) = keys::all().find(|k| k.environment() == name) else {
                let known: Vec<_> = keys::all().map(Key::environment).collect();
                let near = nearest(&name, known.iter().map(String::as_str)).unwrap_or_default();
                return Err(fault::usage(format!(
                    "environment variable {name} names no setting; the nearest is {near}"
                )));
            };
            let value = parse(key, &text).map_err(|why| {
                fault::usage(format!("environment variable {name} = '{text}' {why}"))
            })?;
            self.set(&key.path(), value, Origin::Environment(name));
        }
        Ok(())
    }

    fn apply_file(&mut self, path: &Path, text: &str) -> Result<(), Fault> {
        let root = DeTable::parse(text).map_err(|e| {
            let place = e.span().map_or(String::new(), |s| {
                format!(" line {}", line_of(text, s.start))
            });
            fault::usage(format!(
                "settings file {}{place}: not TOML: {}",
                path.display(),
                e.message().trim()
            ))
        })?;
        self.apply_table(&FileText { path, text }, "", root.get_ref())
    }

    fn apply_table(
        &mut self,
        file: &FileText<'_>,
        section: &str,
        table: &DeTable<'_>,
    ) -> Result<(), Fault> {
        for (name, value) in table {
            let line = line_of(file.text, name.span().start);
            let at = |message: String| {
                fault::usage(format!(
                    "settings file {} line {line}: {message}",
                    file.path.display()
                ))
            };
            let path = if section.is_empty() {
                name.get_ref().to_string()
            } else {
                format!("{section}.{}", name.get_ref())
            };
            if let Some(inner) = value.get_ref().as_table() {
                if !is_section(&path) {
                    return Err(at(unknown_section(&path)));
                }
                self.apply_table(file, &path, inner)?;
                continue;
            }
            let Some(key) = keys::all().find(|k| k.path() == path) else {
                return Err(unknown_path(&path).context(&format!(
                    "settings file {} line {line}",
                    file.path.display()
                )));
            };
            let typed = text_of(value)
                .map_err(|what| at(format!("{path} is {what}, but takes a {}", wanted(key))))?;
            let parsed =
                parse(key, &typed).map_err(|why| at(format!("{path} = '{typed}' {why}")))?;
            self.set(
                &path,
                parsed,
                Origin::File {
                    path: file.path.to_owned(),
                    line,
                },
            );
        }
        Ok(())
    }

    /// Rules that concern two keys.
    fn check_together(&mut self) -> Result<(), Fault> {
        self.check_order("plan.near", "plan.far")?;
        for axis in ["pan", "tilt", "vergence"] {
            self.check_order(&format!("motors.{axis}.min"), &format!("motors.{axis}.max"))?;
        }
        let width = self.entry("screen.width");
        let magnification = self.entry("screen.magnification");
        if width.value == Value::Auto || magnification.origin == Origin::Default {
            return Ok(());
        }
        match width.origin.rank().cmp(&magnification.origin.rank()) {
            std::cmp::Ordering::Greater => Ok(()),
            std::cmp::Ordering::Less => {
                self.set("screen.width", Value::Auto, Origin::Default);
                Ok(())
            }
            std::cmp::Ordering::Equal => Err(fault::usage(format!(
                "screen.width ({}) and screen.magnification ({}) are both set, and each follows from the other",
                width.origin, magnification.origin
            ))
            .hint("set one of the two")),
        }
    }

    fn check_order(&self, low: &str, high: &str) -> Result<(), Fault> {
        let (a, b) = (self.entry(low), self.entry(high));
        if self.number(low) < self.number(high) {
            return Ok(());
        }
        Err(fault::usage(format!(
            "{low} = {} ({}) must be less than {high} = {} ({})",
            print::value_text(a),
            a.origin,
            print::value_text(b),
            b.origin
        )))
    }

    /// The settings alone, as a file.
    pub(crate) fn to_bare_toml(&self) -> String {
        print::bare_toml(self)
    }

    /// The settings as a TOML file with every default, unit and meaning.
    pub(crate) fn to_toml(&self) -> String {
        print::toml(self)
    }

    /// The settings as JSON: `settings.<section>.<key>` with `value`, `unit`, `text`, `origin`, `default`, `meaning`.
    pub(crate) fn to_json(&self) -> serde_json::Value {
        print::json(self)
    }
}

struct FileText<'a> {
    path: &'a Path,
    text: &'a str,
}

impl Fault {
    /// Put the place before the message.
    fn context(self, place: &str) -> Self {
        self.map(|message| format!("{place}: {message}"))
    }
}

/// Whether a name of the environment belongs to a section: other `VERGENCE_` variables are not settings.
fn names_a_section(name: &str) -> bool {
    keys::SECTIONS.iter().any(|(section, _)| {
        let prefix = format!("VERGENCE_{}_", section.replace('.', "_").to_uppercase());
        name.starts_with(&prefix)
    })
}

/// Whether this is a section or holds sections (`motors`).
fn is_section(path: &str) -> bool {
    keys::SECTIONS.iter().any(|(section, _)| {
        *section == path
            || section
                .strip_prefix(path)
                .is_some_and(|r| r.starts_with('.'))
    })
}

fn unknown_section(path: &str) -> String {
    let near = nearest(path, keys::SECTIONS.iter().map(|(name, _)| *name)).unwrap_or_default();
    format!("unknown section [{path}]; the nearest is [{near}]")
}

/// Other names of settings: those of the flags, and what others in the field say.
const ALSO_CALLED: [(&str, &str); 10] = [
    ("base", "rig.interaxial"),
    ("baseline", "rig.interaxial"),
    ("stereo_base", "rig.interaxial"),
    ("focal", "camera.focal_length"),
    ("f", "camera.focal_length"),
    ("sensor", "camera.sensor_width"),
    ("resolution", "camera.width"),
    ("eyes", "screen.interocular"),
    ("ipd", "screen.interocular"),
    ("distance", "screen.viewing_distance"),
];

/// The setting of which this is another name.
fn called(typed: &str) -> Option<&'static str> {
    ALSO_CALLED
        .iter()
        .find(|(name, _)| *name == typed)
        .map(|(_, key)| *key)
}

/// The sentence about a key that does not exist, naming the nearest that does.
fn unknown_path(path: &str) -> Fault {
    let known: Vec<_> = keys::all().map(Key::path).collect();
    let (section, name) = path.rsplit_once('.').unwrap_or(("", path));
    let elsewhere = keys::all()
        .find(|k| k.name == name)
        .map(Key::path)
        .or_else(|| called(name).map(str::to_owned));
    let near = elsewhere.unwrap_or_else(|| {
        let within = known
            .iter()
            .filter(|k| k.rsplit_once('.').is_some_and(|(s, _)| s == section));
        nearest(path, within.map(String::as_str))
            .or_else(|| nearest(path, known.iter().map(String::as_str)))
            .unwrap_or_default()
            .to_owned()
    });
    fault::usage(format!("unknown setting {path}; the nearest is {near}"))
        .hint("`vergence config` lists every setting")
}

/// A scalar of the file as text, or the name of what it is instead.
fn text_of(value: &Spanned<DeValue<'_>>) -> Result<String, &'static str> {
    match value.get_ref() {
        DeValue::String(text) => Ok(text.to_string()),
        DeValue::Integer(number) if number.radix() == 10 => Ok(number.as_str().to_owned()),
        DeValue::Integer(_) => Err("a number that is not decimal"),
        DeValue::Float(number) => Ok(number.as_str().to_owned()),
        DeValue::Boolean(on) => Ok(on.to_string()),
        DeValue::Datetime(_) => Err("a date"),
        DeValue::Array(_) => Err("a list"),
        DeValue::Table(_) => Err("a table"),
    }
}

/// Line of a byte offset, from 1.
fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|b| *b == b'\n').count()
}

/// What a key takes, in words.
fn wanted(key: &Key) -> String {
    match key.kind {
        Kind::Quantity(dimension) => dimension.noun().to_owned(),
        Kind::QuantityOrAuto(dimension) => format!("{} or 'auto'", dimension.noun()),
        Kind::Count => "whole number".to_owned(),
        Kind::Choice(words) => format!("word of {}", words.join(", ")),
        Kind::Switch => "true or false".to_owned(),
        Kind::Text => "text".to_owned(),
    }
}

/// The value of what was typed for a key; the error is the second half of a sentence.
fn parse(key: &Key, text: &str) -> Result<Value, String> {
    match key.kind {
        Kind::Quantity(dimension) => parse_number(key, dimension, text),
        Kind::QuantityOrAuto(_) if text.trim() == "auto" => Ok(Value::Auto),
        Kind::QuantityOrAuto(dimension) => parse_number(key, dimension, text),
        Kind::Count => {
            let Value::Number(number) = parse_number(key, Dimension::Number, text)? else {
                return Err("is no number".to_owned());
            };
            if number.fract() == 0.0 {
                Ok(Value::Number(number))
            } else {
                Err("must be a whole number".to_owned())
            }
        }
        Kind::Choice(words) => {
            let typed = text.trim();
            if words.contains(&typed) {
                return Ok(Value::Word(typed.to_owned()));
            }
            let near = nearest(typed, words.iter().copied()).unwrap_or_default();
            Err(format!(
                "must be one of {}; the nearest is {near}",
                words.join(", ")
            ))
        }
        Kind::Switch => match text.trim() {
            "true" | "on" | "yes" => Ok(Value::Switch(true)),
            "false" | "off" | "no" => Ok(Value::Switch(false)),
            _ => Err("must be true or false".to_owned()),
        },
        Kind::Text if text.is_empty() => Err("must not be empty".to_owned()),
        Kind::Text => Ok(Value::Word(text.to_owned())),
    }
}

fn parse_number(key: &Key, dimension: Dimension, text: &str) -> Result<Value, String> {
    let number = dimension.parse(text)?;
    let say = |bound: f64| dimension.format(bound, key.default);
    let allowed = match key.range {
        Range::Any => None,
        Range::Positive => (number <= 0.0).then(|| "more than 0".to_owned()),
        Range::FromZero => (number < 0.0).then(|| "0 or more".to_owned()),
        Range::Within(low, high) => (number < low || number > high)
            .then(|| format!("between {} and {}", say(low), say(high))),
        Range::ZeroOrWithin(low, high) => (number != 0.0 && (number < low || number > high))
            .then(|| format!("0, or between {} and {}", say(low), say(high))),
    };
    match allowed {
        Some(range) => Err(format!("is out of range: {} must be {range}", key.path())),
        None => Ok(Value::Number(number)),
    }
}

#[cfg(test)]
mod tests;
