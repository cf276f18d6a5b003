//! How fast pictures of a recording are encoded, and whether a recorder keeps up with them at 30 pairs a second:
//! `cargo run --release -p vergence-record --example speed RECORDING.mcap OUT.mcap`.

use std::error::Error;
use std::path::Path;

use vergence_capture::{Clock as _, RealClock, Source as _};
use vergence_record::{
    Beside, Description, FileStorage, Pictures, RecordSettings, Recorder, ReplaySource, WhenFull,
    rows,
};

/// Pairs that are held in memory, and how often they are fed.
const PAIRS: usize = 30;
const ROUNDS: usize = 10;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let (Some(from), Some(to)) = (args.next(), args.next()) else {
        return Err("usage: speed RECORDING.mcap OUT.mcap".into());
    };
    let mut source = ReplaySource::open(Path::new(&from))?;
    let mut pairs = Vec::new();
    while let Some(pair) = source.next_pair(None)?.filter(|_| pairs.len() < PAIRS) {
        pairs.push(pair);
    }
    let mut clock = RealClock::new();
    for pictures in [Pictures::Jpeg(85), Pictures::Png] {
        let (start_s, mut bytes) = (clock.now_s(), 0);
        for pair in &pairs {
            bytes += pictures.encode(&pair.left.picture)?.len();
        }
        let each = 1.0 / pairs.len() as f64;
        println!(
            "{:<5}{:.2} ms and {:.0} kB a picture",
            pictures.format(),
            1e3 * each * (clock.now_s() - start_s),
            1e-3 * each * bytes as f64
        );
    }
    let info = source.info();
    let description = Description {
        facts: Vec::new(),
        attachments: Vec::new(),
        cameras: info.cameras,
        fixed_base_from_cam: info.fixed_base_from_cam,
        fps: info.fps,
        timing: false,
        truth: false,
        epoch_ns: 0,
    };
    let storage = Box::new(FileStorage::create(Path::new(&to))?);
    let settings = RecordSettings::default();
    let mut recorder = Recorder::beside(description, settings, storage, WhenFull::Thin)?;
    let start_s = clock.now_s();
    let mut longest_s = 0.0_f64;
    for n in 0..ROUNDS * pairs.len() {
        clock.sleep_until(start_s + n as f64 / 30.0);
        let before_s = clock.now_s();
        let pair = &pairs[n % pairs.len()];
        recorder.pair(pair, n as f64 / 30.0, Beside::default(), "");
        recorder.happening(&rows::Happening::default());
        longest_s = longest_s.max(clock.now_s() - before_s);
    }
    let (status, result) = recorder.finish(0.0);
    result?;
    println!(
        "{status:?}\nthe caller was held up for {:.2} ms at most",
        1e3 * longest_s
    );
    Ok(())
}
