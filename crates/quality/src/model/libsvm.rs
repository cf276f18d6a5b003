//! libsvm's text files: models of `svm-train` and ranges of `svm-scale -s`.
//!
//! A folder holds `class.model` (`svm-train -b 1`: C-SVC, radial kernel, labels 1 to 5 in the order of [`DISTORTIONS`]) and for each class a
//! regressor, `reg1.model` to `reg5.model` or `jp2k.model` to `ff.model` (ε-SVR or ν-SVR, radial kernel). Beside each lies the range that its
//! features were scaled with under the same name with `.range`; where one range serves all it may be `all.range`.

use std::path::Path;

use super::scaling::line;
use super::{
    CLASSES, Classifier, DISTORTIONS, MAX_MODEL_BYTES, MAX_SUPPORT_VECTORS, Model, ModelError,
    PAIRS, Regressor, Scaling, Support,
};
use crate::features::{FEATURE_COUNT, Features};

const LICENCE: &str = "that of the files it was imported from";

/// A model of `svm-train` and the range of `svm-scale` that belongs to it, as text.
#[derive(Clone, Copy, Debug)]
pub struct LibsvmText<'a> {
    /// What the two are called in messages: `class`.
    pub name: &'a str,
    /// The model file.
    pub model: &'a str,
    /// The range file.
    pub range: &'a str,
}

impl Model {
    /// Make a model of libsvm's text files: the classifier, and the regressors in the order of [`DISTORTIONS`].
    ///
    /// # Errors
    /// [`ModelError::Libsvm`] with the file and the line, or what [`Model::check`] finds.
    pub fn from_libsvm(
        name: &str,
        classifier: LibsvmText<'_>,
        regressors: [LibsvmText<'_>; CLASSES],
    ) -> Result<Self, ModelError> {
        let mut read = Vec::new();
        for text in regressors {
            read.push(regressor_from(text)?);
        }
        let regressors = <[Regressor; CLASSES]>::try_from(read).map_err(|_| ModelError::Unknown)?;
        let model = Model {
            name: name.to_owned(),
            trained_on: "imported from text files of libsvm".to_owned(),
            licence: LICENCE.to_owned(),
            classifier: classifier_from(classifier)?,
            regressors,
        };
        model.check()?;
        Ok(model)
    }

    /// [`Model::from_libsvm`] of the files in a folder; the names are at the top of `libsvm.rs`: `class`, `reg1` to `reg5` or `jp2k` to `ff`,
    /// each `.model` with its `.range` or with `all.range`.
    ///
    /// # Errors
    /// As [`Model::from_libsvm`], and a file that is not there or too large.
    pub fn from_libsvm_folder(name: &str, folder: &Path) -> Result<Self, ModelError> {
        let mut texts = vec![Texts::read(folder, "class".to_owned())?];
        for (i, class) in DISTORTIONS.iter().enumerate() {
            let numbered = format!("reg{}", i + 1);
            let called = if folder.join(format!("{numbered}.model")).exists() {
                numbered
            } else {
                class.id().to_owned()
            };
            texts.push(Texts::read(folder, called)?);
        }
        let regressors = std::array::from_fn(|i| texts[i + 1].borrow());
        Self::from_libsvm(name, texts[0].borrow(), regressors)
    }
}

/// The two files as read.
struct Texts {
    name: String,
    model: String,
    range: String,
}

impl Texts {
    fn read(folder: &Path, name: String) -> Result<Self, ModelError> {
        let model = read_text(&folder.join(format!("{name}.model")))?;
        let own = folder.join(format!("{name}.range"));
        let range = match own.exists() {
            true => read_text(&own)?,
            false => read_text(&folder.join("all.range")).map_err(|_| ModelError::Libsvm {
                file: name.clone(),
                line: 0,
                reason: format!("there is neither {name}.range nor all.range beside {name}.model"),
            })?,
        };
        Ok(Self { name, model, range })
    }

    fn borrow(&self) -> LibsvmText<'_> {
        LibsvmText {
            name: &self.name,
            model: &self.model,
            range: &self.range,
        }
    }
}

fn read_text(path: &Path) -> Result<String, ModelError> {
    use std::io::Read as _;
    let io = |source| ModelError::Io {
        path: path.to_owned(),
        source,
    };
    let mut text = String::new();
    let file = std::fs::File::open(path).map_err(io)?;
    file.take(MAX_MODEL_BYTES as u64 + 1)
        .read_to_string(&mut text)
        .map_err(io)?;
    if text.len() > MAX_MODEL_BYTES {
        return Err(ModelError::TooLarge);
    }
    Ok(text)
}

fn classifier_from(text: LibsvmText<'_>) -> Result<Classifier, ModelError> {
    let svm = Svm::read(text)?;
    svm.kind(&["c_svc"], "svm-train -s 0 -t 2 -b 1")?;
    svm.classes(CLASSES)?;
    let numbers: [usize; CLASSES] = svm.whole("label", svm.header.label.as_deref())?;
    let mut labels = [DISTORTIONS[0]; CLASSES];
    for (label, number) in labels.iter_mut().zip(numbers) {
        *label = *(number.checked_sub(1).and_then(|n| DISTORTIONS.get(n)))
            .ok_or_else(|| svm.wrong(format!("label {number} is none of 1 to {CLASSES}")))?;
    }
    let range = Range::read(text)?;
    let coefficients = svm.vectors.iter().map(|(row, _)| {
        <[f64; CLASSES - 1]>::try_from(row.as_slice())
            .map_err(|_| svm.wrong("a support vector has not four coefficients".to_owned()))
    });
    Ok(Classifier {
        labels,
        counts: svm.whole("nr_sv", svm.header.nr_sv.as_deref())?,
        coefficients: coefficients.collect::<Result<_, _>>()?,
        rho: svm.array("rho", svm.header.rho.as_deref())?,
        prob_a: svm.array::<PAIRS>("probA", svm.header.prob_a.as_deref())?,
        prob_b: svm.array::<PAIRS>("probB", svm.header.prob_b.as_deref())?,
        scaling: range.scaling,
        support: svm.support()?,
    })
}

fn regressor_from(text: LibsvmText<'_>) -> Result<Regressor, ModelError> {
    let svm = Svm::read(text)?;
    svm.kind(&["epsilon_svr", "nu_svr"], "svm-train -s 3 -t 2")?;
    svm.classes(2)?;
    let range = Range::read(text)?;
    // Where the ratings were scaled too, the line back is put into the coefficients.
    let (factor, offset) = range.rating;
    let coefficients = svm.vectors.iter().map(|(row, _)| match row.as_slice() {
        [one] => Ok(factor * one),
        _ => Err(svm.wrong("a support vector has not one coefficient".to_owned())),
    });
    let [rho] = svm.array("rho", svm.header.rho.as_deref())?;
    Ok(Regressor {
        scaling: range.scaling,
        coefficients: coefficients.collect::<Result<_, _>>()?,
        rho: factor * rho - offset,
        support: svm.support()?,
    })
}

/// The lines before the support vectors.
#[derive(Default)]
struct Header {
    svm_type: String,
    kernel_type: String,
    gamma: Option<f64>,
    nr_class: Option<f64>,
    total_sv: Option<f64>,
    rho: Option<Vec<f64>>,
    label: Option<Vec<f64>>,
    prob_a: Option<Vec<f64>>,
    prob_b: Option<Vec<f64>>,
    nr_sv: Option<Vec<f64>>,
}

/// A model file as read.
struct Svm {
    file: String,
    header: Header,
    /// Coefficients and support vectors.
    vectors: Vec<(Vec<f64>, Features)>,
}

impl Svm {
    fn read(text: LibsvmText<'_>) -> Result<Self, ModelError> {
        let mut svm = Self {
            file: format!("{}.model", text.name),
            header: Header::default(),
            vectors: Vec::new(),
        };
        let mut lines = (1..).zip(text.model.lines());
        loop {
            let Some((number, line)) = lines.next() else {
                return Err(svm.wrong("it ends before its support vectors".to_owned()));
            };
            if line.trim() == "SV" {
                break;
            }
            svm.take_header(line)
                .map_err(|reason| svm.at(number, reason))?;
        }
        for (number, line) in lines.filter(|(_, l)| !l.trim().is_empty()) {
            if svm.vectors.len() == MAX_SUPPORT_VECTORS {
                let most = format!("more than {MAX_SUPPORT_VECTORS} support vectors");
                return Err(svm.at(number, most));
            }
            let vector = vector_from(line).map_err(|reason| svm.at(number, reason))?;
            svm.vectors.push(vector);
        }
        let total = svm.header.total_sv;
        if total != Some(svm.vectors.len() as f64) {
            let found = svm.vectors.len();
            let total = total.map_or("nothing".to_owned(), |t| t.to_string());
            let reason = format!("it has {found} support vectors where total_sv says {total}");
            return Err(svm.wrong(reason));
        }
        Ok(svm)
    }

    fn take_header(&mut self, line: &str) -> Result<(), String> {
        let (key, rest) = line.trim().split_once(' ').unwrap_or((line.trim(), ""));
        let numbers = || -> Result<Vec<f64>, String> {
            rest.split_whitespace()
                .take(2 * PAIRS)
                .map(number)
                .collect()
        };
        let one = || number(rest);
        let header = &mut self.header;
        match key {
            "svm_type" => rest.trim().clone_into(&mut header.svm_type),
            "kernel_type" => rest.trim().clone_into(&mut header.kernel_type),
            "gamma" => header.gamma = Some(one()?),
            "nr_class" => header.nr_class = Some(one()?),
            "total_sv" => header.total_sv = Some(one()?),
            "rho" => header.rho = Some(numbers()?),
            "label" => header.label = Some(numbers()?),
            // A regression's probA is the width of its Laplace noise: not used here.
            "probA" => header.prob_a = Some(numbers()?),
            "probB" => header.prob_b = Some(numbers()?),
            "nr_sv" => header.nr_sv = Some(numbers()?),
            "degree" | "coef0" => {}
            other => {
                let shown: String = other.chars().take(20).collect();
                return Err(format!("{shown:?} is no key of a libsvm model"));
            }
        }
        Ok(())
    }

    fn at(&self, line: usize, reason: String) -> ModelError {
        ModelError::Libsvm {
            file: self.file.clone(),
            line,
            reason,
        }
    }

    fn wrong(&self, reason: String) -> ModelError {
        self.at(0, reason)
    }

    fn kind(&self, types: &[&str], made_by: &str) -> Result<(), ModelError> {
        let (svm, kernel) = (&self.header.svm_type, &self.header.kernel_type);
        if types.contains(&svm.as_str()) && kernel == "rbf" {
            return Ok(());
        }
        Err(self.wrong(format!(
            "it is a {svm:?} with kernel {kernel:?}; needed is one of {made_by}"
        )))
    }

    fn classes(&self, count: usize) -> Result<(), ModelError> {
        if self.header.nr_class == Some(count as f64) {
            return Ok(());
        }
        let found = self.header.nr_class.unwrap_or(0.0);
        Err(self.wrong(format!("it has {found} classes, not {count}")))
    }

    fn array<const N: usize>(
        &self,
        key: &str,
        numbers: Option<&[f64]>,
    ) -> Result<[f64; N], ModelError> {
        let numbers = numbers.unwrap_or(&[]);
        numbers.try_into().map_err(|_| {
            let found = numbers.len();
            let hint = match (found, key) {
                (0, "probA" | "probB") => " (train with -b 1)",
                _ => "",
            };
            self.wrong(format!("{key} has {found} numbers, not {N}{hint}"))
        })
    }

    fn whole<const N: usize>(
        &self,
        key: &str,
        numbers: Option<&[f64]>,
    ) -> Result<[usize; N], ModelError> {
        let numbers = self.array::<N>(key, numbers)?;
        let whole = |v: &f64| *v >= 0.0 && *v <= f64::from(u32::MAX) && v.fract() == 0.0;
        if !numbers.iter().all(whole) {
            return Err(self.wrong(format!("{key} has a number that is no count")));
        }
        Ok(numbers.map(|v| v as usize))
    }

    fn support(&self) -> Result<Support, ModelError> {
        let gamma = (self.header.gamma).ok_or_else(|| self.wrong("it has no gamma".to_owned()))?;
        Ok(Support {
            gamma,
            vectors: self.vectors.iter().map(|(_, v)| *v).collect(),
        })
    }
}

fn number(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let shown = || text.chars().take(20).collect::<String>();
    let value: f64 = text
        .parse()
        .map_err(|_| format!("{:?} is not a number", shown()))?;
    if !value.is_finite() {
        return Err(format!("{:?} is not a finite number", shown()));
    }
    Ok(value)
}

/// Coefficients, then `index:value` with rising indices from 1; what is not named is 0.
fn vector_from(line: &str) -> Result<(Vec<f64>, Features), String> {
    let mut coefficients = Vec::new();
    let mut vector = [0.0; FEATURE_COUNT];
    let mut last = 0;
    for word in line.split_whitespace() {
        let Some((index, value)) = word.split_once(':') else {
            if last > 0 || coefficients.len() == CLASSES {
                return Err("coefficients are out of place".to_owned());
            }
            coefficients.push(number(word)?);
            continue;
        };
        let index = index_from(index, last)?;
        vector[index - 1] = number(value)?;
        last = index;
    }
    Ok((coefficients, vector))
}

fn index_from(text: &str, last: usize) -> Result<usize, String> {
    let index: usize = text
        .parse()
        .map_err(|_| "the number of a feature is none".to_owned())?;
    if index <= last {
        return Err(format!("feature {index} follows feature {last}"));
    }
    if index > FEATURE_COUNT {
        return Err(format!(
            "it has a feature {index}; this index has {FEATURE_COUNT}"
        ));
    }
    Ok(index)
}

/// A range file as read.
struct Range {
    scaling: Scaling,
    /// Factor and offset from a scaled rating to the rating.
    rating: (f64, f64),
}

impl Range {
    /// `y`, its scaled and its true ends (only of `svm-scale -y`); then `x`, the scaled ends, and number, lowest and highest value of each
    /// feature. A feature that is not named, because it was constant, is 0 to libsvm.
    fn read(text: LibsvmText<'_>) -> Result<Self, ModelError> {
        let file = format!("{}.range", text.name);
        let at = |line: usize| {
            let file = file.clone();
            move |reason: String| ModelError::Libsvm { file, line, reason }
        };
        let mut lines = (1..)
            .zip(text.range.lines())
            .filter(|(_, l)| !l.trim().is_empty());
        let mut ends = |what: &str| {
            let (number, line) = lines
                .next()
                .ok_or_else(|| at(0)(format!("it ends before {what}")))?;
            Ok::<_, ModelError>((number, line.trim()))
        };
        let mut rating = (1.0, 0.0);
        let (mut number, mut mark) = ends("its mark x")?;
        if mark == "y" {
            let (n, scaled) = ends("the scaled ends of y")?;
            let [lower, upper] = numbers_of(scaled).map_err(at(n))?;
            let (n, true_ends) = ends("the ends of y")?;
            let [low, high] = numbers_of(true_ends).map_err(at(n))?;
            rating = line(lower, upper, low, high);
            (number, mark) = ends("its mark x")?;
        }
        if mark != "x" {
            return Err(at(number)("here \"x\" belongs".to_owned()));
        }
        let (n, scaled) = ends("the scaled ends of x")?;
        let [lower, upper] = numbers_of(scaled).map_err(at(n))?;
        let mut scaling = Scaling {
            a: [0.0; FEATURE_COUNT],
            b: [0.0; FEATURE_COUNT],
        };
        let mut last = 0;
        for (n, text) in lines {
            let (index, rest) = text.trim().split_once(' ').unwrap_or((text, ""));
            let index = index_from(index, last).map_err(at(n))?;
            let [low, high] = numbers_of(rest).map_err(at(n))?;
            (scaling.a[index - 1], scaling.b[index - 1]) = line(low, high, lower, upper);
            last = index;
        }
        if last == 0 {
            return Err(at(0)("it names no feature".to_owned()));
        }
        Ok(Self { scaling, rating })
    }
}

fn numbers_of(line: &str) -> Result<[f64; 2], String> {
    let mut words = line.split_whitespace();
    let (a, b) = (words.next(), words.next());
    match (a, b, words.next()) {
        (Some(a), Some(b), None) => Ok([number(a)?, number(b)?]),
        _ => Err("two numbers belong here".to_owned()),
    }
}
