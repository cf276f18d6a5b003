//! `cargo xtask bench-vs numpy`: parallax of many points beside the same closed form in NumPy, in one run on one thread.
//!
//! Both sides make the same points, and their numbers are compared before any time is printed. NumPy is written three
//! ways (`peers/parallax_numpy.py`); the ratio is to the fastest of them at each size. Memory bandwidth is measured in
//! the same run by a STREAM-like triad over as many bytes.

use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use vergence_geometry::bulk::Parallaxes;
use vergence_geometry::{ModeKind, Screen, StereoArray};

/// In the first cache, in the second, in the last, far out of every cache (640 MiB).
const SIZES: [usize; 4] = [1 << 10, 1 << 14, 1 << 18, 1 << 24];
/// Each way is repeated for this long; the fastest repetition counts.
const MEASURE: Duration = Duration::from_millis(600);
/// Bytes that one point moves: x, y, z in, p, q out.
const BYTES_PER_POINT: f64 = 40.0;
/// Each side is measured this often, in turn, and its best counts, so that a neighbour's noise hits both alike.
const ROUNDS: usize = 3;
/// With it the C library asks the system for large pages, as NumPy does by itself.
const HUGE_PAGES: &str = "GLIBC_TUNABLES";
/// Ratio to reach.
const TARGET: f64 = 5.0;

/// Runs both sides and prints the table; an error when they differ, or when python3 or NumPy is missing.
pub(crate) fn run() -> anyhow::Result<()> {
    ensure!(
        std::env::var_os(HUGE_PAGES).is_some(),
        "NumPy asks the system for large pages by itself; {HUGE_PAGES} lets the C library do so for this side too: start it by \
         `cargo xtask bench-vs numpy`"
    );
    let array = StereoArray {
        mode: ModeKind::Converged.at(2.0),
        ..StereoArray::default()
    };
    let form = Parallaxes::new(&array.views()?, 0, &Screen::default())?;
    println!("parallax p, q of a converged pair, float64, one thread");
    println!(
        "   points  vergence  plain loop  NumPy best (way)            ratio  to plain NumPy  GB/s  triad GB/s  of bandwidth"
    );
    let mut worst = f64::INFINITY;
    for n in SIZES {
        let mut ours = measure(&form, n)?;
        let mut peer = numpy(n)?;
        let difference = largest_difference(&ours, &peer);
        ensure!(
            difference <= 1e-15,
            "vergence and NumPy differ by {difference:e} m at {n} points, at most 1e-15 m is rounding"
        );
        let mut triad = triad_bytes_per_s(n);
        for _ in 1..ROUNDS {
            ours.keep_best(&measure(&form, n)?);
            peer.keep_best(numpy(n)?);
            triad = triad.max(triad_bytes_per_s(n));
        }
        let ratio = ours.rate / peer.rate;
        worst = worst.min(ratio);
        let bytes = ours.rate * BYTES_PER_POINT;
        println!(
            "{n:>9}  {:>6.0} M/s  {:>6.0} M/s  {:>6.0} M/s ({:<14})  {ratio:>6.1}  {:>14.1}  {:>5.1}  {:>9.1}  {:>9.0} %",
            ours.rate / 1e6,
            ours.plain_rate / 1e6,
            peer.rate / 1e6,
            peer.way,
            ours.rate / peer.plain_rate,
            bytes / 1e9,
            triad / 1e9,
            100.0 * bytes / triad,
        );
        if n == SIZES[SIZES.len() - 1] {
            println!("NumPy {}: {}", peer.version, peer.all);
        }
    }
    let verdict = if worst >= TARGET { "reached" } else { "missed" };
    println!(
        "smallest ratio {worst:.1}; the target of {TARGET} is {verdict}. Both sides agree to 1e-15 m."
    );
    Ok(())
}

struct Ours {
    rate: f64,
    plain_rate: f64,
    p: Vec<f64>,
    q: Vec<f64>,
}

impl Ours {
    fn keep_best(&mut self, other: &Ours) {
        self.rate = self.rate.max(other.rate);
        self.plain_rate = self.plain_rate.max(other.plain_rate);
    }
}

impl Peer {
    fn keep_best(&mut self, other: Peer) {
        let plain_rate = self.plain_rate.max(other.plain_rate);
        if other.rate > self.rate {
            *self = other;
        }
        self.plain_rate = plain_rate;
    }
}

struct Peer {
    rate: f64,
    /// Of the way with a new array for every operation.
    plain_rate: f64,
    way: String,
    all: String,
    version: String,
    /// p, then q.
    values: Vec<f64>,
}

fn measure(form: &Parallaxes, n: usize) -> anyhow::Result<Ours> {
    // Exactly the points of the Python side.
    let along = |step: f64, width: f64, from: f64| -> Vec<f64> {
        (0..n)
            .map(|i| (i as f64 * step) % 1.0 * width + from)
            .collect()
    };
    let x = along(0.61803398875, 2.0, -1.0);
    let y = along(0.75487766625, 1.6, -0.8);
    let z = along(0.56984029099, 9.0, 1.0);
    let (mut p, mut q) = (vec![0.0; n], vec![0.0; n]);
    form.evaluate(&x, &y, &z, &mut p, &mut q)?;
    let plain_rate = n as f64
        / fastest(n, || {
            // The lengths were checked by the call above.
            let _ = form.evaluate_scalar(black_box(&x), &y, &z, &mut p, &mut q);
        });
    let rate = n as f64
        / fastest(n, || {
            let _ = form.evaluate(black_box(&x), &y, &z, &mut p, &mut q);
        });
    Ok(Ours {
        rate,
        plain_rate,
        p,
        q,
    })
}

/// Seconds of the fastest repetition; small arrays are repeated inside one measurement, as on the other side.
fn fastest(n: usize, mut work: impl FnMut()) -> f64 {
    let inner = (200_000 / n).max(1);
    work();
    let mut best = f64::INFINITY;
    let begin = Instant::now();
    while begin.elapsed() < MEASURE {
        let start = Instant::now();
        for _ in 0..inner {
            work();
        }
        best = best.min(start.elapsed().as_secs_f64() / inner as f64);
    }
    best
}

/// Bytes per second of `a[i] = b[i] + s c[i]` over as many bytes as the points take, counted as STREAM does: what the
/// program reads and writes, not what the cache fetches for it.
fn triad_bytes_per_s(n: usize) -> f64 {
    let length = n * 5 / 3;
    let (b, c) = (vec![1.5; length], vec![2.5; length]);
    let mut a = vec![0.0; length];
    let seconds = fastest(n, || {
        triad(&mut a, black_box(&b), &c);
        black_box(&mut a);
    });
    (length * 24) as f64 / seconds
}

#[inline(never)]
fn triad(a: &mut [f64], b: &[f64], c: &[f64]) {
    for ((a, b), c) in a.iter_mut().zip(b).zip(c) {
        *a = b + 3.0 * c;
    }
}

fn numpy(n: usize) -> anyhow::Result<Peer> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/parallax_numpy.py");
    let values =
        std::env::temp_dir().join(format!("vergence-numpy-{}-{n}.f64", std::process::id()));
    let output = Command::new("python3")
        .arg(&script)
        .args([n.to_string(), MEASURE.as_secs_f64().to_string()])
        .arg(&values)
        .output()
        .context("python3 could not be started; bench-vs numpy needs python3 with numpy")?;
    if !output.status.success() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    let bytes = std::fs::read(&values).with_context(|| {
        format!(
            "the peer's numbers could not be read from {}",
            values.display()
        )
    });
    // Whatever was read is in memory now; a file left behind would only be litter.
    let _ = std::fs::remove_file(&values);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout)
        .context("the peer's report is not the JSON that it should be")?;
    let rates = report["rates"]
        .as_object()
        .context("the peer's report has no rates")?;
    let rate_of = |value: &serde_json::Value| value.as_f64().unwrap_or(0.0);
    let (way, rate) = rates
        .iter()
        .map(|(way, rate)| (way.clone(), rate_of(rate)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .context("the peer measured nothing")?;
    let all: Vec<String> = rates
        .iter()
        .map(|(way, rate)| format!("{way} {:.0} M/s", rate_of(rate) / 1e6))
        .collect();
    Ok(Peer {
        rate,
        plain_rate: rate_of(&report["rates"]["plain"]),
        way,
        all: all.join(", "),
        version: report["numpy"].as_str().unwrap_or("?").to_owned(),
        values: bytes?
            .chunks_exact(8)
            .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
            .collect(),
    })
}

/// Largest difference of any p or q, metres; NaN on one side only, or another number of values, is infinite.
fn largest_difference(ours: &Ours, peer: &Peer) -> f64 {
    if peer.values.len() != ours.p.len() + ours.q.len() {
        return f64::INFINITY;
    }
    ours.p
        .iter()
        .chain(&ours.q)
        .zip(&peer.values)
        .map(|(a, b)| match (a.is_nan(), b.is_nan()) {
            (true, true) => 0.0,
            (false, false) => (a - b).abs(),
            _ => f64::INFINITY,
        })
        .fold(0.0, f64::max)
}
