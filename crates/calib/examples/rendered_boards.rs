//! Random rendered boards, many of them:
//! `cargo run --release -p vergence-calib --example rendered_boards -- [COUNT [FIRST_SEED]]`.

#[allow(dead_code, reason = "shared with a test")]
#[path = "../tests/boards/mod.rs"]
mod boards;

use boards::{CASES, Case, Shot, errors, random_shot};
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
    let words: Vec<String> = std::env::args().skip(1).collect();
    let number = |word: Option<&String>, otherwise: u64| {
        word.map_or(otherwise, |n| match n.parse() {
            Ok(n) => n,
            Err(e) => panic!("usage: rendered_boards [COUNT [FIRST_SEED]]: {n}: {e}"),
        })
    };
    let count = number(words.first(), 2500);
    let first = number(words.get(1), 1);
    let mut all = Tally::default();
    for case in CASES {
        let share = first..first + count / CASES.len() as u64;
        let tally = Tally::of(share, |seed| (TARGETS[seed as usize % TARGETS.len()], case));
        println!("{case:?}: {}", tally.line());
        for (what, names) in [
            ("wrong", &tally.wrong),
            ("fits both", &tally.fits_both),
            ("missed", &tally.missed),
        ] {
            for name in names {
                println!("  {what}: {name}");
            }
        }
        all.add_all(tally);
    }
    println!("all: {}", all.line());
}

include!("../tests/boards/tally.rs");
