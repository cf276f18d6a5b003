//! Examples in a file, so that training can be tried again without making the pictures again.

use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use serde_json::{Value, json};
use vergence_quality::FEATURE_COUNT;

use crate::distort::Step;
use crate::examples::Example;
use crate::measures::{MEASURES, Measures};

/// One line of JSON for each example; numbers read back are the numbers written.
pub fn write(path: &Path, examples: &[Example]) -> Result<()> {
    let mut file = BufWriter::new(std::fs::File::create(path)?);
    for e in examples {
        let steps: Vec<Value> = e.steps.iter().map(|&s| value_from_step(s)).collect();
        let alone: Vec<Value> = e.alone.iter().map(|m| json!(m.all())).collect();
        let line = json!({
            "scene": e.scene,
            "steps": steps,
            "features": e.features.as_slice(),
            "measures": e.measures.all(),
            "alone": alone,
        });
        writeln!(file, "{line}")?;
    }
    file.flush()?;
    Ok(())
}

/// What [`write()`] wrote.
pub fn read(path: &Path) -> Result<Vec<Example>> {
    let file = BufReader::new(std::fs::File::open(path)?);
    let mut examples = Vec::new();
    for line in file.lines() {
        let value: Value = serde_json::from_str(&line?)?;
        examples.push(example_from(&value).with_context(|| path.display().to_string())?);
    }
    Ok(examples)
}

fn example_from(value: &Value) -> Result<Example> {
    let list = |key: &str| value[key].as_array().context("a list is missing");
    let steps: Result<Vec<Step>> = list("steps")?.iter().map(step_from).collect();
    let alone: Result<Vec<Measures>> = list("alone")?.iter().map(measures_from).collect();
    Ok(Example {
        scene: usize::try_from(value["scene"].as_u64().context("no scene")?)?,
        steps: steps?,
        features: numbers::<FEATURE_COUNT>(&value["features"])?,
        measures: measures_from(&value["measures"])?,
        alone: alone?,
    })
}

fn measures_from(value: &Value) -> Result<Measures> {
    let [ms_ssim, iw_ssim, vif, fsim, gms] = numbers::<MEASURES>(value)?;
    Ok(Measures::from_all([ms_ssim, iw_ssim, vif, fsim, gms]))
}

fn numbers<const N: usize>(value: &Value) -> Result<[f64; N]> {
    let list: Option<Vec<f64>> = value
        .as_array()
        .and_then(|a| a.iter().map(Value::as_f64).collect());
    match list.map(<[f64; N]>::try_from) {
        Some(Ok(numbers)) => Ok(numbers),
        _ => bail!("no list of {N} numbers"),
    }
}

fn value_from_step(step: Step) -> Value {
    match step {
        Step::Blur(v) => json!(["blur", v]),
        Step::Noise(v) => json!(["noise", v]),
        Step::Jpeg(v) => json!(["jpeg", v]),
        Step::Jpeg2000(v) => json!(["jpeg2000", v]),
        Step::Fading(v) => json!(["fading", v]),
    }
}

fn step_from(value: &Value) -> Result<Step> {
    let strength = value[1].as_f64().context("a step without strength")?;
    Ok(match value[0].as_str() {
        Some("blur") => Step::Blur(strength),
        Some("noise") => Step::Noise(strength),
        Some("jpeg") => Step::Jpeg(strength as u8),
        Some("jpeg2000") => Step::Jpeg2000(strength),
        Some("fading") => Step::Fading(strength),
        _ => bail!("an unknown step"),
    })
}
