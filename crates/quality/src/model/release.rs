//! The model file of the DIIVINE release (`data_live_trained.mat`): which variable of MATLAB means what.
//!
//! `a_class`, `b_class` (1 x 88) and `a_reg`, `b_reg` (5 x 88) scale the features, `model_class` is libsvm's structure of the classifier,
//! `model_reg` a cell array of five of the regressors. The file has only numbers for the classes: 1 JPEG 2000, 2 JPEG, 3 white noise,
//! 4 Gaussian blur, 5 fast fading.

use std::collections::BTreeMap;

use super::matlab::{self, Value};
use super::{
    CLASSES, Classifier, DISTORTIONS, MAX_MODEL_BYTES, MAX_SUPPORT_VECTORS, Model, ModelError,
    PAIRS, Regressor, Scaling, Support,
};
use crate::features::{FEATURE_COUNT, Features};

const WANTED: [&str; 6] = [
    "a_class",
    "b_class",
    "a_reg",
    "b_reg",
    "model_class",
    "model_reg",
];

const TRAINED_ON: &str = "imported from a MATLAB file of the DIIVINE release (Moorthy and Bovik 2011, \"DIVINE Software Release\", \
     Laboratory for Image and Video Engineering, The University of Texas at Austin), which was trained on the LIVE database";

const LICENCE: &str = "not part of this project; copyright (c) 2010 The University of Texas at Austin: free to use, copy, change and pass on with \
     its notice in every copy, LIVE and CPS at UT Austin acknowledged and the paper and the release cited in publications; no warranty";

impl Model {
    /// Import the MATLAB level-5 file of the DIIVINE release, or one laid out like it.
    ///
    /// # Errors
    /// A file that is not MATLAB's, or without the parts of that model; one sentence that says what is missing.
    pub fn from_matlab(bytes: &[u8], name: &str) -> Result<Self, ModelError> {
        if bytes.len() > MAX_MODEL_BYTES {
            return Err(ModelError::TooLarge);
        }
        let file = File(matlab::variables(bytes, &WANTED)?);
        let model = Model {
            name: name.to_owned(),
            trained_on: TRAINED_ON.to_owned(),
            licence: LICENCE.to_owned(),
            classifier: file.classifier()?,
            regressors: file.regressors()?,
        };
        model.check()?;
        Ok(model)
    }
}

fn missing(what: impl Into<String>) -> ModelError {
    ModelError::NotThatModel {
        missing: what.into(),
    }
}

/// The variables of the file.
struct File(BTreeMap<String, Value>);

impl File {
    fn variable(&self, name: &str) -> Result<&Value, ModelError> {
        self.0
            .get(name)
            .ok_or_else(|| missing(format!("it has no variable {name}")))
    }

    /// The rows of a full matrix of features.
    fn rows(&self, name: &str, rows: usize) -> Result<Vec<Features>, ModelError> {
        match self.variable(name)? {
            Value::Full { size, values } if *size == [rows, FEATURE_COUNT] => {
                let row = |r| std::array::from_fn(|c| values[c * rows + r]);
                Ok((0..rows).map(row).collect())
            }
            other => Err(missing(format!(
                "{name} is {}, not a {rows} x {FEATURE_COUNT} matrix",
                other.kind()
            ))),
        }
    }

    fn scalings(&self, a: &str, b: &str, rows: usize) -> Result<Vec<Scaling>, ModelError> {
        let pairs = self
            .rows(a, rows)?
            .into_iter()
            .zip(self.rows(b, rows)?)
            .map(|(a, b)| Scaling { a, b });
        Ok(pairs.collect())
    }

    fn classifier(&self) -> Result<Classifier, ModelError> {
        let scaling = self.scalings("a_class", "b_class", 1)?.remove(0);
        let svm = Structure::of("model_class", self.variable("model_class")?)?;
        svm.kind(&[0.0], "a C-SVC classifier")?;
        let support = svm.support()?;
        let vectors = support.vectors.len();
        let numbers: [f64; CLASSES] = svm.array("Label")?;
        let mut labels = [DISTORTIONS[0]; CLASSES];
        for (label, number) in labels.iter_mut().zip(numbers) {
            let place = (1..=CLASSES).find(|n| *n as f64 == number);
            let place = place.ok_or_else(|| svm.wrong("Label", "the numbers 1 to 5"))?;
            *label = DISTORTIONS[place - 1];
        }
        let counts = svm.array::<CLASSES>("nSV")?;
        let flat = svm.numbers("sv_coef", vectors * (CLASSES - 1))?;
        let coefficients = (0..vectors)
            .map(|sv| std::array::from_fn(|column| flat[column * vectors + sv]))
            .collect();
        Ok(Classifier {
            scaling,
            labels,
            support,
            counts: counts.map(|n| n as usize),
            coefficients,
            rho: svm.array::<PAIRS>("rho")?,
            prob_a: svm.array::<PAIRS>("ProbA")?,
            prob_b: svm.array::<PAIRS>("ProbB")?,
        })
    }

    fn regressors(&self) -> Result<[Regressor; CLASSES], ModelError> {
        let scalings = self.scalings("a_reg", "b_reg", CLASSES)?;
        let cells = match self.variable("model_reg")? {
            Value::Cell(cells) if cells.len() == CLASSES => cells,
            other => {
                return Err(missing(format!(
                    "model_reg is {}, not a cell array of {CLASSES}",
                    other.kind()
                )));
            }
        };
        let mut regressors = Vec::new();
        for (i, (scaling, cell)) in scalings.into_iter().zip(cells).enumerate() {
            let name = format!("model_reg{{{}}}", i + 1);
            let svm = Structure::of(&name, cell)?;
            // ε-SVR and ν-SVR predict alike; the release has the second.
            svm.kind(&[3.0, 4.0], "a support vector regression")?;
            let support = svm.support()?;
            regressors.push(Regressor {
                scaling,
                coefficients: svm.numbers("sv_coef", support.vectors.len())?.to_vec(),
                rho: svm.array::<1>("rho")?[0],
                support,
            });
        }
        <[Regressor; CLASSES]>::try_from(regressors)
            .map_err(|_| missing("model_reg is not five regressors"))
    }
}

/// libsvm's structure of a model in MATLAB.
struct Structure<'a> {
    name: &'a str,
    fields: &'a BTreeMap<String, Value>,
}

impl<'a> Structure<'a> {
    fn of(name: &'a str, value: &'a Value) -> Result<Self, ModelError> {
        match value {
            Value::Struct(all) if all.len() == 1 => Ok(Self {
                name,
                fields: &all[0],
            }),
            other => Err(missing(format!(
                "{name} is {}, not one structure of libsvm",
                other.kind()
            ))),
        }
    }

    fn wrong(&self, field: &str, must: &str) -> ModelError {
        let found = self
            .fields
            .get(field)
            .map_or("missing".to_owned(), Value::kind);
        missing(format!("{}.{field} is {found}, not {must}", self.name))
    }

    /// So many numbers, in a matrix of any shape.
    fn numbers(&self, field: &str, count: usize) -> Result<&'a [f64], ModelError> {
        match self.fields.get(field) {
            Some(Value::Full { values, .. }) if values.len() == count => Ok(values),
            _ => Err(self.wrong(field, &format!("{count} numbers"))),
        }
    }

    fn array<const N: usize>(&self, field: &str) -> Result<[f64; N], ModelError> {
        let numbers = self.numbers(field, N)?;
        Ok(std::array::from_fn(|i| numbers[i]))
    }

    /// Whether `Parameters` names one of these types and the radial kernel.
    fn kind(&self, types: &[f64], must: &str) -> Result<(), ModelError> {
        let [kind, kernel, ..] = self.array::<5>("Parameters")?;
        if !types.contains(&kind) || kernel != 2.0 {
            return Err(missing(format!(
                "{} is of type {kind} with kernel {kernel}, not {must} (type {}) with radial kernel (2)",
                self.name,
                types
                    .iter()
                    .map(f64::to_string)
                    .collect::<Vec<_>>()
                    .join(" or "),
            )));
        }
        Ok(())
    }

    fn support(&self) -> Result<Support, ModelError> {
        let [_, _, _, gamma, _] = self.array::<5>("Parameters")?;
        let count = self.array::<1>("totalSV")?[0];
        let count = (0..=MAX_SUPPORT_VECTORS)
            .contains(&(count as usize))
            .then_some(count as usize);
        let count = count.ok_or_else(|| self.wrong("totalSV", "a count that is accepted"))?;
        let size = [count, FEATURE_COUNT];
        let mut vectors = vec![[0.0; FEATURE_COUNT]; count];
        match self.fields.get("SVs") {
            Some(Value::Sparse {
                size: found,
                entries,
            }) if *found == size => {
                for (row, column, value) in entries {
                    vectors[*row][*column] = *value;
                }
            }
            Some(Value::Full {
                size: found,
                values,
            }) if *found == size => {
                for (i, value) in values.iter().enumerate() {
                    vectors[i % count][i / count] = *value;
                }
            }
            _ => {
                return Err(self.wrong("SVs", &format!("a {count} x {FEATURE_COUNT} matrix")));
            }
        }
        Ok(Support { gamma, vectors })
    }
}
