//! Random rendered boards, many of them: `cargo run --release -p vergence-calib --example rendered_boards -- 2000`.

#[allow(dead_code, reason = "shared with a test")]
#[path = "../tests/boards/mod.rs"]
mod boards;

use boards::{CASES, Case, errors, random_shot};
use vergence_calib::{Target, detect};

const TARGETS: [&str; 6] = [
    "chessboard:9x6:25mm",
    "charuco:5x7:40mm:30mm:DICT_4X4_50",
    "charuco:8x6:30mm:20mm:DICT_6X6_250:legacy",
    "charuco:7x5:40mm:28mm:DICT_5X5_100:inverted",
    "aprilgrid:6x6:88mm:0.3",
    "chessboard:8x5:30mm",
];

fn target(text: &str) -> Target {
    match Target::parse(text) {
        Ok(target) => target,
        Err(e) => panic!("{e}"),
    }
}

fn main() {
    let count = std::env::args()
        .nth(1)
        .and_then(|n| n.parse().ok())
        .unwrap_or(2000);
    let first = 10_000;
    let mut all = Tally::default();
    for case in CASES {
        let share = first..first + count / CASES.len() as u64;
        let tally = Tally::of(share, |seed| (TARGETS[seed as usize % TARGETS.len()], case));
        println!(
            "{case:?}: fair {}, found {}, beyond {}, refused {}, corners {}, wrong {:?}, missed {:?}",
            tally.fair,
            tally.found,
            tally.found_beyond,
            tally.refused,
            tally.corners,
            tally.wrong,
            tally.missed
        );
        all.fair += tally.fair;
        all.found += tally.found;
        all.found_beyond += tally.found_beyond;
        all.refused += tally.refused;
        all.corners += tally.corners;
        all.wrong.extend(tally.wrong);
    }
    println!(
        "all: {} fair, {} of them found, {} found beyond, {} refused, {} corners, {} wrong",
        all.fair,
        all.found,
        all.found_beyond,
        all.refused,
        all.corners,
        all.wrong.len()
    );
}

include!("../tests/boards/tally.rs");
