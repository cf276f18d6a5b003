//! `cargo xtask bench-vs diivine`: the 88 features beside a double-precision complex 2-D Fourier transform of the same
//! size, beside themselves on two threads, and beside NumPy and SciPy, all in one run; and the memory that they take.
//!
//! The features of both sides are compared before any time is printed. Times are the best of rounds in which all sides are
//! measured in turn, so that a neighbour's noise hits them alike.

use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, bail, ensure};
use vergence_fft::Complex64;
use vergence_fft::double::ComplexFft2;
use vergence_imaging::{Gray, Plane};
use vergence_quality::{FEATURE_NAMES, Features, features_from_gray};

use crate::ALLOCATOR;

/// About 0.2, 0.8, 2 and 8 megapixels.
const SIZES: [(usize, usize); 4] = [(512, 384), (1024, 768), (1632, 1224), (3264, 2448)];
/// The goals are for this one.
const GOAL_SIZE: (usize, usize) = (1024, 768);
/// At most this many transforms, on one thread.
const MOST_TRANSFORMS: f64 = 30.0;
/// At least this much faster on two threads.
const LEAST_GAIN: f64 = 1.7;
/// At most this many numbers of 8 bytes per pixel.
const MOST_NUMBERS: f64 = 25.0;
/// Largest picture that the peer is given: it keeps fifteen numbers per pixel of one band at a time.
const PEER_PIXELS: usize = 3_000_000;
/// Wall time for each size's rounds, seconds.
const MEASURE_S: f64 = 12.0;
/// Fewest rounds, however long they take.
const ROUNDS: usize = 5;

/// Runs all sides and prints the table; an error when they differ, or when python3, NumPy or SciPy is missing.
pub(crate) fn run() -> anyhow::Result<()> {
    println!("DIIVINE's 88 features, best of rounds, milliseconds");
    println!(
        "       size  1 complex FFT  first call  one thread  in FFTs  two threads   gain  numbers/pixel  NumPy+SciPy  ratio"
    );
    let mut goals = String::new();
    for size in SIZES {
        let picture = picture(size);
        let peer = (size.0 * size.1 <= PEER_PIXELS)
            .then(|| peer(&picture))
            .transpose()?;
        let ours = measure(&picture)?;
        if let Some(peer) = &peer {
            compare(&ours.features, &peer.features)?;
        }
        let [in_ffts, gain] = [ours.one / ours.fft, ours.one / ours.two];
        let (peer_ms, ratio) = peer.as_ref().map_or(("-".into(), "-".into()), |p| {
            let ratio = p.seconds / ours.one;
            (format!("{:.0}", 1e3 * p.seconds), format!("{ratio:.1}"))
        });
        println!(
            "{:>5} x {:<4} {:>13.2}  {:>10.1}  {:>10.1}  {in_ffts:>7.1}  {:>11.1}  {gain:>5.2}  {:>13.1}  {peer_ms:>11}  {ratio:>5}",
            size.0,
            size.1,
            1e3 * ours.fft,
            1e3 * ours.first,
            1e3 * ours.one,
            1e3 * ours.two,
            ours.numbers,
        );
        if size == GOAL_SIZE {
            let verdict = |reached: bool| if reached { "reached" } else { "missed" };
            goals = format!(
                "at {} x {}: at most {MOST_TRANSFORMS} transforms {}, gain of {LEAST_GAIN} on two threads {}, at most {MOST_NUMBERS} numbers per pixel {}",
                size.0,
                size.1,
                verdict(in_ffts <= MOST_TRANSFORMS),
                verdict(gain >= LEAST_GAIN),
                verdict(ours.numbers <= MOST_NUMBERS),
            );
        }
    }
    println!("{goals}. Both sides agree within the tolerances of the reference data.");
    Ok(())
}

/// A smooth scene with grain; every step costs the same whatever is shown.
fn picture((width, height): (usize, usize)) -> Gray {
    let mut state = 1_u32;
    Plane::from_fn(width, height, |x, y| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let (x, y) = (x as f64, y as f64);
        let waves = 60.0 * (x / 37.0).sin() * (y / 23.0).cos() + 30.0 * (x * y / 9000.0).sin();
        (128.0 + waves + f64::from(state >> 27) - 16.0).clamp(0.0, 255.0) as u8
    })
}

/// Seconds, but for the last two.
struct Ours {
    fft: f64,
    /// The first picture of its size, on one thread: memory and masks are made.
    first: f64,
    one: f64,
    two: f64,
    /// 8 bytes per pixel each, at the peak.
    numbers: f64,
    features: Features,
}

fn measure(picture: &Gray) -> anyhow::Result<Ours> {
    let (width, height) = picture.size();
    let on = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let (single, double) = (on(1)?, on(2)?);
    ALLOCATOR.reset_peak_usage();
    let start = Instant::now();
    let features = single.install(|| features_from_gray(picture))?;
    let first = start.elapsed().as_secs_f64();
    let numbers = ALLOCATOR.peak_usage() as f64 / (8 * width * height) as f64;
    ensure!(
        double.install(|| features_from_gray(picture))? == features,
        "two threads give other numbers than one"
    );
    let fft = ComplexFft2::new(width, height);
    let samples = picture.samples().iter();
    let samples: Vec<Complex64> = samples
        .map(|&v| Complex64::new(f64::from(v), 0.0))
        .collect();
    let mut spectrum = samples.clone();
    let mut best = [f64::INFINITY; 3];
    let begin = Instant::now();
    let mut rounds = 0;
    while rounds < ROUNDS || begin.elapsed().as_secs_f64() < MEASURE_S {
        spectrum.copy_from_slice(&samples);
        keep_best(&mut best[0], || fft.forward(black_box(&mut spectrum)));
        keep_best(&mut best[1], || {
            let _ = black_box(single.install(|| features_from_gray(black_box(picture))));
        });
        keep_best(&mut best[2], || {
            let _ = black_box(double.install(|| features_from_gray(black_box(picture))));
        });
        rounds += 1;
    }
    let [fft, one, two] = best;
    Ok(Ours {
        fft,
        first,
        one,
        two,
        numbers,
        features,
    })
}

fn keep_best(best: &mut f64, work: impl FnOnce()) {
    let start = Instant::now();
    work();
    *best = best.min(start.elapsed().as_secs_f64());
}

struct Peer {
    seconds: f64,
    features: Vec<f64>,
}

fn peer(picture: &Gray) -> anyhow::Result<Peer> {
    let (width, height) = picture.size();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/diivine_numpy.py");
    let name = format!("vergence-diivine-{}-{width}.u8", std::process::id());
    let raw = std::env::temp_dir().join(name);
    std::fs::write(&raw, picture.samples())
        .with_context(|| format!("the picture could not be written to {}", raw.display()))?;
    let output = Command::new("python3")
        .arg(&script)
        .args(["bench", &width.to_string(), &height.to_string()])
        .arg(&raw)
        .arg("6")
        .output();
    // Whatever was read is read by now; a file left behind would only be litter.
    let _ = std::fs::remove_file(&raw);
    let output = output.context(
        "python3 could not be started; bench-vs diivine needs python3 with numpy and scipy",
    )?;
    if !output.status.success() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    let report: serde_json::Value = serde_json::from_slice(&output.stdout)
        .context("the peer's report is not the JSON that it should be")?;
    let features = report["features"].as_array().context("no features")?;
    Ok(Peer {
        seconds: report["seconds"].as_f64().context("no seconds")?,
        features: features.iter().filter_map(|v| v.as_f64()).collect(),
    })
}

/// The tolerances of the reference data.
fn compare(ours: &Features, peer: &[f64]) -> anyhow::Result<()> {
    ensure!(
        peer.len() == ours.len(),
        "the peer gave {} features",
        peer.len()
    );
    for (i, (a, b)) in ours.iter().zip(peer).enumerate() {
        let allowed = match i {
            0..12 => 1e-8 * b.abs(),
            12..31 => 1e-9,
            _ => 1e-9 * b.abs(),
        };
        ensure!(
            (a - b).abs() <= allowed,
            "{} is {a}, the peer says {b}",
            FEATURE_NAMES[i]
        );
    }
    Ok(())
}
