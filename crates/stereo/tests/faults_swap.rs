//! x
#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]
#[allow(dead_code)]
mod recorded;
use vergence_imaging::colour::luma_from_rgb;
use vergence_stereo::dense::{DenseSettings, disparity_map};
use vergence_stereo::faults::swap::*;

#[test]
fn recorded_pairs_both_ways() {
    let Some(data) = recorded::data_folder("recorded_pairs_both_ways") else {
        return;
    };
    let mut pairs = recorded::disparity_pairs(&data);
    pairs.extend(recorded::photographs(&data));
    for pair in pairs {
        let grey = [luma_from_rgb(&pair.left), luma_from_rgb(&pair.right)];
        for way in 0..2 {
            let map = disparity_map(
                [&grey[way], &grey[1 - way]],
                &|_, _| 0.0,
                &DenseSettings::default(),
            )
            .unwrap();
            let swap = swap_from_map(&map);
            println!(
                "{:12} {way} {:?} {:.2} cov {:.2} range {:?} scale {:.2}",
                pair.name,
                swap.decision,
                swap.log_odds,
                map.coverage(),
                map.range_px,
                map.scale
            );
            for s in &swap.signs {
                println!("      {} {:.2} {}", s.name, s.log_odds, s.places);
            }
        }
    }
}
