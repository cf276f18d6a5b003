//! Our own model file: JSON that holds all of a model.
//!
//! ```json
//! { "format": "vergence quality model", "version": 1, "features": "diivine 88",
//!   "scale": "0 best, 100 worst",
//!   "name": "..", "trained_on": "..", "licence": "..", "numbers": "f64",
//!   "classifier": { "a": [88], "b": [88], "classes": ["jp2k", "jpeg", "wn", "blur", "ff"], "gamma": 0.01,
//!     "counts": [5], "support_vectors": [[88], ..], "coefficients": [[4], ..],
//!     "rho": [10], "prob_a": [10], "prob_b": [10] },
//!   "regressors": { "jp2k": { "a": [88], "b": [88], "gamma": 0.01,
//!     "support_vectors": [[88], ..], "coefficients": [..], "rho": 0.0 }, "jpeg": .., "wn": .., "blur": .., "ff": .. } }
//! ```
//!
//! Numbers are written with the fewest digits that give the same number back. With `"numbers": "f32"` the support vectors are single
//! precision (their digits say so: half the file); everything else always is double. [`Model::to_json`] writes so where nothing is lost.

use std::fmt;

use serde::de::{SeqAccess, Visitor};
use serde::ser::SerializeSeq;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::error::sized;
use super::{
    CLASSES, Classifier, Distortion, MAX_MODEL_BYTES, Model, ModelError, Regressor, Scaling,
    Support,
};
use crate::features::{FEATURE_COUNT, Features};

const FORMAT: &str = "vergence quality model";
const VERSION: u32 = 1;
const FEATURES: &str = "diivine 88";
const SCALE: &str = "0 best, 100 worst";

#[derive(Serialize, Deserialize)]
#[serde(
    deny_unknown_fields,
    bound(serialize = "V: Serialize", deserialize = "V: Kept + Deserialize<'de>")
)]
struct ModelFile<V> {
    format: String,
    version: u32,
    features: String,
    scale: String,
    name: String,
    trained_on: String,
    licence: String,
    numbers: Numbers,
    classifier: ClassifierFile<V>,
    regressors: RegressorFiles<V>,
}

/// The beginning of a file, to know how to read the rest.
#[derive(Deserialize)]
struct Head {
    format: Option<String>,
    version: Option<u32>,
    features: Option<String>,
    scale: Option<String>,
    numbers: Option<Numbers>,
}

#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Numbers {
    F32,
    F64,
}

#[derive(Serialize, Deserialize)]
#[serde(
    deny_unknown_fields,
    bound(serialize = "V: Serialize", deserialize = "V: Kept + Deserialize<'de>")
)]
struct ClassifierFile<V> {
    a: Vec<Number<f64>>,
    b: Vec<Number<f64>>,
    classes: Vec<Distortion>,
    gamma: Number<f64>,
    counts: Vec<usize>,
    support_vectors: Vec<Row<V, FEATURE_COUNT>>,
    coefficients: Vec<Row<f64, 4>>,
    rho: Vec<Number<f64>>,
    prob_a: Vec<Number<f64>>,
    prob_b: Vec<Number<f64>>,
}

#[derive(Serialize, Deserialize)]
#[serde(
    deny_unknown_fields,
    bound(serialize = "V: Serialize", deserialize = "V: Kept + Deserialize<'de>")
)]
struct RegressorFiles<V> {
    jp2k: RegressorFile<V>,
    jpeg: RegressorFile<V>,
    wn: RegressorFile<V>,
    blur: RegressorFile<V>,
    ff: RegressorFile<V>,
}

#[derive(Serialize, Deserialize)]
#[serde(
    deny_unknown_fields,
    bound(serialize = "V: Serialize", deserialize = "V: Kept + Deserialize<'de>")
)]
struct RegressorFile<V> {
    a: Vec<Number<f64>>,
    b: Vec<Number<f64>>,
    gamma: Number<f64>,
    support_vectors: Vec<Row<V, FEATURE_COUNT>>,
    coefficients: Vec<Number<f64>>,
    rho: Number<f64>,
}

impl Model {
    /// Read our own model file.
    ///
    /// # Errors
    /// Anything that is not such a file, a number that is not finite, a size that does not fit; one sentence that names the field.
    pub fn from_json(bytes: &[u8]) -> Result<Self, ModelError> {
        if bytes.len() > MAX_MODEL_BYTES {
            return Err(ModelError::TooLarge);
        }
        let (head, cleaned) = match serde_json::from_slice::<Head>(bytes) {
            Ok(head) => (head, None),
            // Programs that write NaN into JSON are known; the name of the field then says more than a line and a column.
            Err(_) => {
                let cleaned = null_for_nan(bytes);
                (
                    serde_json::from_slice(&cleaned).map_err(json)?,
                    Some(cleaned),
                )
            }
        };
        head.check()?;
        let bytes = cleaned.as_deref().unwrap_or(bytes);
        let model = match head.numbers {
            Some(Numbers::F32) => serde_json::from_slice::<ModelFile<f32>>(bytes)
                .map_err(json)?
                .model()?,
            Some(Numbers::F64) | None => serde_json::from_slice::<ModelFile<f64>>(bytes)
                .map_err(json)?
                .model()?,
        };
        model.check()?;
        Ok(model)
    }

    /// Our own model file; [`Model::from_json`] gives the same model back, to the last bit.
    ///
    /// # Errors
    /// As [`Model::check`]: what could not be read again is not written.
    pub fn to_json(&self) -> Result<String, ModelError> {
        self.check()?;
        let single = |v: &Features| v.iter().all(|v| f64::from(*v as f32) == *v);
        let supports = std::iter::once(&self.classifier.support)
            .chain(self.regressors.iter().map(|r| &r.support));
        let text = if supports.flat_map(|s| &s.vectors).all(single) {
            serde_json::to_string(&ModelFile::<f32>::of(self, Numbers::F32))
        } else {
            serde_json::to_string(&ModelFile::<f64>::of(self, Numbers::F64))
        };
        text.map(|t| broken_into_lines(&t)).map_err(json)
    }
}

#[allow(clippy::needless_pass_by_value, reason = "it is passed to map_err")]
fn json(error: serde_json::Error) -> ModelError {
    ModelError::Json {
        reason: error.to_string(),
    }
}

impl Head {
    fn check(&self) -> Result<(), ModelError> {
        let other = |field: &str, found: &str, must: &str| {
            Err(ModelError::Json {
                reason: format!("its {field} is {found}, not {must}"),
            })
        };
        if self.format.as_deref() != Some(FORMAT) {
            let found = format!("{:?}", self.format.as_deref().unwrap_or("missing"));
            return other("\"format\"", &found, &format!("{FORMAT:?}"));
        }
        if self.version != Some(VERSION) {
            let found = self.version.map_or("missing".to_owned(), |v| v.to_string());
            return other("\"version\"", &found, &VERSION.to_string());
        }
        for (field, found, must) in [
            ("\"features\"", &self.features, FEATURES),
            ("\"scale\"", &self.scale, SCALE),
        ] {
            if found.as_deref() != Some(must) {
                let found = format!("{:?}", found.as_deref().unwrap_or("missing"));
                return other(field, &found, &format!("{must:?}"));
            }
        }
        Ok(())
    }
}

/// The text with `null` for every NaN and infinity outside of strings, as some programs write them.
fn null_for_nan(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(bytes.len());
    let (mut at, mut quoted) = (0, false);
    while let Some(&byte) = bytes.get(at) {
        let rest = &bytes[at..];
        let word = [
            "NaN",
            "-NaN",
            "nan",
            "-nan",
            "Infinity",
            "-Infinity",
            "inf",
            "-inf",
        ]
        .iter()
        .find(|w| !quoted && rest.starts_with(w.as_bytes()));
        if let Some(word) = word {
            out.extend(b"null");
            at += word.len();
            continue;
        }
        let step = if quoted && byte == b'\\' { 2 } else { 1 };
        quoted ^= byte == b'"';
        out.extend(rest.iter().take(step));
        at += step;
    }
    out
}

/// A line for every support vector and field, so that two models can be compared with the usual tools.
fn broken_into_lines(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + text.len() / 64);
    let (mut in_string, mut escaped) = (false, false);
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        out.push(c);
        if in_string {
            in_string = escaped || c != '"';
            escaped = !escaped && c == '\\';
            continue;
        }
        in_string = c == '"';
        let breaks = match c {
            '[' => chars.peek() == Some(&'['),
            ',' => matches!(chars.peek(), Some('[' | '"')),
            _ => false,
        };
        if breaks {
            out.push('\n');
        }
    }
    out.push('\n');
    out
}

/// A number of the file. `null` is taken as NaN, which the check of the model refuses by the name of its field.
#[derive(Clone, Copy)]
struct Number<V>(V);

impl<V: Serialize> Serialize for Number<V> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(to)
    }
}

impl<'de, V: Deserialize<'de> + From<f32>> Deserialize<'de> for Number<V> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        Ok(Self(
            Option::<V>::deserialize(from)?.unwrap_or_else(|| f32::NAN.into()),
        ))
    }
}

/// A row of so many numbers, in memory as such.
struct Row<V, const N: usize>([V; N]);

impl<V: Serialize, const N: usize> Serialize for Row<V, N> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let mut row = to.serialize_seq(Some(N))?;
        for value in &self.0 {
            row.serialize_element(value)?;
        }
        row.end()
    }
}

impl<'de, V: Kept + Deserialize<'de>, const N: usize> Deserialize<'de> for Row<V, N> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct RowVisitor<V, const N: usize>(std::marker::PhantomData<V>);
        impl<'de, V: Kept + Deserialize<'de>, const N: usize> Visitor<'de> for RowVisitor<V, N> {
            type Value = Row<V, N>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a row of {N} numbers")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut row: A) -> Result<Self::Value, A::Error> {
                let mut out = [V::from(0.0); N];
                for (i, value) in out.iter_mut().enumerate() {
                    let Some(Number(v)) = row.next_element()? else {
                        return Err(serde::de::Error::invalid_length(i, &self));
                    };
                    *value = v;
                }
                match row.next_element::<serde::de::IgnoredAny>()? {
                    None => Ok(Row(out)),
                    Some(_) => Err(serde::de::Error::invalid_length(N + 1, &self)),
                }
            }
        }
        from.deserialize_seq(RowVisitor(std::marker::PhantomData))
    }
}

/// A number of a support vector as it is kept in the file.
trait Kept: Copy + From<f32> {
    fn keep(value: f64) -> Self;
    fn take(self) -> f64;
}

impl Kept for f32 {
    fn keep(value: f64) -> Self {
        value as f32
    }
    fn take(self) -> f64 {
        f64::from(self)
    }
}

impl Kept for f64 {
    fn keep(value: f64) -> Self {
        value
    }
    fn take(self) -> f64 {
        self
    }
}

fn numbers_of(values: &[f64]) -> Vec<Number<f64>> {
    values.iter().map(|v| Number(*v)).collect()
}

fn rows_of<V: Kept>(support: &Support) -> Vec<Row<V, FEATURE_COUNT>> {
    let row = |v: &Features| Row(v.map(V::keep));
    support.vectors.iter().map(row).collect()
}

fn support_from<V: Kept>(gamma: Number<f64>, rows: Vec<Row<V, FEATURE_COUNT>>) -> Support {
    Support {
        gamma: gamma.0,
        vectors: rows.into_iter().map(|r| r.0.map(V::take)).collect(),
    }
}

fn array_from<const N: usize>(
    field: &str,
    numbers: &[Number<f64>],
) -> Result<[f64; N], ModelError> {
    sized(field, numbers.len(), N)?;
    Ok(std::array::from_fn(|i| numbers[i].0))
}

fn scaling_from(field: &str, a: &[Number<f64>], b: &[Number<f64>]) -> Result<Scaling, ModelError> {
    Ok(Scaling {
        a: array_from(&format!("{field}.a"), a)?,
        b: array_from(&format!("{field}.b"), b)?,
    })
}

impl<V: Kept> ModelFile<V> {
    fn of(model: &Model, numbers: Numbers) -> Self {
        let [jp2k, jpeg, wn, blur, ff] = &model.regressors;
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            features: FEATURES.to_owned(),
            scale: SCALE.to_owned(),
            name: model.name.clone(),
            trained_on: model.trained_on.clone(),
            licence: model.licence.clone(),
            numbers,
            classifier: ClassifierFile::of(&model.classifier),
            regressors: RegressorFiles {
                jp2k: RegressorFile::of(jp2k),
                jpeg: RegressorFile::of(jpeg),
                wn: RegressorFile::of(wn),
                blur: RegressorFile::of(blur),
                ff: RegressorFile::of(ff),
            },
        }
    }

    fn model(self) -> Result<Model, ModelError> {
        let r = self.regressors;
        Ok(Model {
            name: self.name,
            trained_on: self.trained_on,
            licence: self.licence,
            classifier: self.classifier.classifier()?,
            regressors: [
                r.jp2k.regressor("regressors.jp2k")?,
                r.jpeg.regressor("regressors.jpeg")?,
                r.wn.regressor("regressors.wn")?,
                r.blur.regressor("regressors.blur")?,
                r.ff.regressor("regressors.ff")?,
            ],
        })
    }
}

impl<V: Kept> ClassifierFile<V> {
    fn of(c: &Classifier) -> Self {
        Self {
            a: numbers_of(&c.scaling.a),
            b: numbers_of(&c.scaling.b),
            classes: c.labels.to_vec(),
            gamma: Number(c.support.gamma),
            counts: c.counts.to_vec(),
            support_vectors: rows_of(&c.support),
            coefficients: c.coefficients.iter().map(|r| Row(*r)).collect(),
            rho: numbers_of(&c.rho),
            prob_a: numbers_of(&c.prob_a),
            prob_b: numbers_of(&c.prob_b),
        }
    }

    fn classifier(self) -> Result<Classifier, ModelError> {
        sized("classifier.classes", self.classes.len(), CLASSES)?;
        sized("classifier.counts", self.counts.len(), CLASSES)?;
        Ok(Classifier {
            scaling: scaling_from("classifier", &self.a, &self.b)?,
            labels: std::array::from_fn(|i| self.classes[i]),
            support: support_from(self.gamma, self.support_vectors),
            counts: std::array::from_fn(|i| self.counts[i]),
            coefficients: self.coefficients.into_iter().map(|r| r.0).collect(),
            rho: array_from("classifier.rho", &self.rho)?,
            prob_a: array_from("classifier.prob_a", &self.prob_a)?,
            prob_b: array_from("classifier.prob_b", &self.prob_b)?,
        })
    }
}

impl<V: Kept> RegressorFile<V> {
    fn of(r: &Regressor) -> Self {
        Self {
            a: numbers_of(&r.scaling.a),
            b: numbers_of(&r.scaling.b),
            gamma: Number(r.support.gamma),
            support_vectors: rows_of(&r.support),
            coefficients: numbers_of(&r.coefficients),
            rho: Number(r.rho),
        }
    }

    fn regressor(self, field: &str) -> Result<Regressor, ModelError> {
        Ok(Regressor {
            scaling: scaling_from(field, &self.a, &self.b)?,
            support: support_from(self.gamma, self.support_vectors),
            coefficients: self.coefficients.iter().map(|n| n.0).collect(),
            rho: self.rho.0,
        })
    }
}
